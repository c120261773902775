"""Evaluation of retrieval: metrics, precision over recall, confusion matrices and the separation of classes."""

from unbend.matching.evaluate.evaluation import ClassMetrics, Evaluation, evaluate
from unbend.matching.evaluate.metrics import PrecisionRecall, RetrievalMetrics
from unbend.matching.evaluate.separation import Clusters, Separation, clusters, separation

__all__ = [
    "ClassMetrics",
    "Clusters",
    "Evaluation",
    "PrecisionRecall",
    "RetrievalMetrics",
    "Separation",
    "clusters",
    "evaluate",
    "separation",
]
