"""Evaluation of retrieval: metrics, precision over recall, confusion matrices and the separation of classes."""

from unbend.matching.evaluate.evaluation import Evaluation, evaluate
from unbend.matching.evaluate.metrics import PrecisionRecall, RetrievalMetrics
from unbend.matching.evaluate.separation import Clusters, Separation, clusters, separation
from unbend.matching.evaluate.summary import ClassMetrics, Confusion, EvaluationSummary

__all__ = [
    "ClassMetrics",
    "Clusters",
    "Confusion",
    "Evaluation",
    "EvaluationSummary",
    "PrecisionRecall",
    "RetrievalMetrics",
    "Separation",
    "clusters",
    "evaluate",
    "separation",
]
