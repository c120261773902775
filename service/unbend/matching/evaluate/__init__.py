"""How well a measure retrieves: figures, precision and recall, confusions; leave-one-out or against a gallery."""

from unbend.matching.evaluate.curves import PrecisionRecall
from unbend.matching.evaluate.evaluation import ClassFigures, Evaluation, evaluate, leave_one_out
from unbend.matching.evaluate.figures import E_MEASURE_RANK, RetrievalFigures, nearest_class_accuracy
from unbend.matching.evaluate.separation import Clusters, Separation, clusters, separation

__all__ = [
    "E_MEASURE_RANK",
    "ClassFigures",
    "Clusters",
    "Evaluation",
    "PrecisionRecall",
    "RetrievalFigures",
    "Separation",
    "clusters",
    "evaluate",
    "leave_one_out",
    "nearest_class_accuracy",
    "separation",
]
