"""The classifiers by name."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from unbend.errors import ParameterError
from unbend.matching.classification.classifier import Classifier
from unbend.matching.classification.discriminants import DISCRIMINANTS
from unbend.matching.classification.means import MEAN
from unbend.matching.classification.nearest import NEAREST
from unbend.matching.classification.vote import VOTE

CLASSIFIERS: Final[Mapping[str, Classifier]] = MappingProxyType(
    {classifier.name: classifier for classifier in (NEAREST, VOTE, MEAN, DISCRIMINANTS)}
)

DEFAULT_CLASSIFIER: Final = NEAREST.name


def get_classifier(name: str) -> Classifier:
    """Return the classifier called `name`; ParameterError lists the known ones."""
    if name not in CLASSIFIERS:
        raise ParameterError(f"classifier must be one of {', '.join(CLASSIFIERS)}, not {name!r}")
    return CLASSIFIERS[name]
