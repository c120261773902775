"""Classification of a query: `classify` is the main function, and `registry` lists the classifiers."""

from unbend.matching.classification.classify import Classification, ClassMatch, classify
from unbend.matching.classification.registry import CLASSIFIERS, DEFAULT_CLASSIFIER, get_classifier
from unbend.matching.classification.samples import SAMPLE, ClassSamples

__all__ = [
    "CLASSIFIERS",
    "DEFAULT_CLASSIFIER",
    "SAMPLE",
    "ClassMatch",
    "ClassSamples",
    "Classification",
    "classify",
    "get_classifier",
]
