"""The answers of a library, as immutable values: the same near (`Library`) and far (`Client`)."""

from unbend.matching.classification import ClassMatch
from unbend.matching.evaluate import ClassMetrics, Confusion, PrecisionRecall, RetrievalMetrics
from unbend.results.evaluations import EvaluationResult
from unbend.results.jobs import JobFailure, JobStatus
from unbend.results.maps import MapItem, ShapeMap
from unbend.results.points import PointMap
from unbend.results.rankings import PartRelation, Ranking, ShapeMatch
from unbend.results.shapes import AddedShape, ShapePage, ShapeRecord

__all__ = [
    "AddedShape",
    "ClassMatch",
    "ClassMetrics",
    "Confusion",
    "EvaluationResult",
    "JobFailure",
    "JobStatus",
    "MapItem",
    "PartRelation",
    "PointMap",
    "PrecisionRecall",
    "Ranking",
    "RetrievalMetrics",
    "ShapeMap",
    "ShapeMatch",
    "ShapePage",
    "ShapeRecord",
]
