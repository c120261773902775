"""The classifiers by name."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from unbend.errors import check_choice
from unbend.matching.classification.classifier import Classifier
from unbend.matching.classification.discriminants import DISCRIMINANTS
from unbend.matching.classification.means import MEAN
from unbend.matching.classification.neighbours import NEAREST, VOTE

CLASSIFIERS: Final[Mapping[str, Classifier]] = MappingProxyType(
    {classifier.name: classifier for classifier in (NEAREST, VOTE, MEAN, DISCRIMINANTS)}
)

DEFAULT_CLASSIFIER: Final = NEAREST.name


def get_classifier(name: str) -> Classifier:
    """Return the classifier called `name`, or raise ParameterError, which lists the names."""
    check_choice("classifier", name, CLASSIFIERS)
    return CLASSIFIERS[name]
