"""Classification of a query: `classify` is the main function, and `registry` lists the classifiers."""

from unbend.matching.classification.classify import Classification, ClassMatch, classify
from unbend.matching.classification.registry import CLASSIFIERS, DEFAULT_CLASSIFIER, get_classifier

__all__ = [
    "CLASSIFIERS",
    "DEFAULT_CLASSIFIER",
    "ClassMatch",
    "Classification",
    "classify",
    "get_classifier",
]
