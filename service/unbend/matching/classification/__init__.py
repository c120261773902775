"""Which class a query belongs to: a module for each classifier, behind one protocol."""

from unbend.matching.classification.answer import Classification, ClassMatch
from unbend.matching.classification.classify import classify
from unbend.matching.classification.registry import CLASSIFIERS, DEFAULT_CLASSIFIER, get_classifier

__all__ = [
    "CLASSIFIERS",
    "DEFAULT_CLASSIFIER",
    "ClassMatch",
    "Classification",
    "classify",
    "get_classifier",
]
