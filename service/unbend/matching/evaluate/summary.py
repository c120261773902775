"""The results of an evaluation as a small immutable value that survives a round trip through JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, Final, Self

from unbend.brief import brief, counted, noted
from unbend.matching.evaluate.metrics import PrecisionRecall, RetrievalMetrics

_METRICS: Final = tuple(field.name for field in fields(RetrievalMetrics))


@dataclass(frozen=True)
class ClassMetrics:
    """The results of the queries of one class."""

    label: str
    queries: int
    """The number of queries, including those without a signature."""
    members: int
    """The number of shapes of the class in the gallery, including queries that are left out of their own ranking."""
    accuracy: float
    """The share of queries whose nearest shape belongs to this class. A query without a signature counts as wrong."""
    metrics: RetrievalMetrics | None
    """None if no query with a signature has another shape of the class in the gallery."""

    def as_dict(self) -> dict[str, Any]:
        """Return plain JSON values. Metrics are fields of the same object, and None if there are none."""
        counts = {name: getattr(self, name) for name in ("label", "queries", "members", "accuracy")}
        return counts | _metrics_as_dict(self.metrics)


@dataclass(frozen=True)
class Confusion:
    """Confusions between classes."""

    labels: tuple[str, ...]
    counts: tuple[tuple[int, ...], ...]
    """Number of queries by their class (row) and the class of the nearest shape (column)."""

    def __repr__(self) -> str:
        return brief(
            self, counted(len(self.labels), "class", "classes"), counted(sum(map(sum, self.counts)), "query", "queries")
        )


@dataclass(frozen=True)
class EvaluationSummary:
    """The results of ranking a gallery for each of several queries."""

    metrics: RetrievalMetrics | None
    """Means over the queries whose class has another shape in the gallery; None if there are no such queries."""
    accuracy: float
    """The share of all queries whose nearest shape belongs to their class."""
    queries: int
    """The number of queries, including unanswered ones."""
    unanswered: int
    """The number of queries without a signature. They count as wrong in `accuracy`; the metrics ignore them."""
    classes: tuple[ClassMetrics, ...]
    confusion: Confusion | None
    """None for more than 1000 classes."""
    precision_recall: PrecisionRecall

    def __repr__(self) -> str:
        return brief(self, *facts_of(self))

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """Return the summary of JSON values."""
        confusion, curve = values["confusion"], values["precision_recall"]
        classes = [
            ClassMetrics(row["label"], row["queries"], row["members"], row["accuracy"], _metrics_of(row))
            for row in values["classes"]
        ]
        own: dict[str, Any] = {
            "metrics": _metrics_of(values),
            "classes": tuple(classes),
            "confusion": confusion and Confusion(tuple(confusion["labels"]), tuple(map(tuple, confusion["counts"]))),
            "precision_recall": PrecisionRecall(tuple(curve["recall"]), tuple(curve["precision"])),
        }
        others = {field.name: values[field.name] for field in fields(cls) if field.name not in own}
        return cls(**own, **others)

    def as_dict(self) -> dict[str, Any]:
        """Return plain JSON values. The metrics are fields of the same object."""
        confusion, curve = self.confusion, self.precision_recall
        own = {
            "classes": [row.as_dict() for row in self.classes],
            "confusion": confusion
            and {"labels": list(confusion.labels), "counts": [list(row) for row in confusion.counts]},
            "precision_recall": {"recall": list(curve.recall), "precision": list(curve.precision)},
        }
        return _metrics_as_dict(self.metrics) | {
            field.name: own.get(field.name, getattr(self, field.name))
            for field in fields(self)
            if field.name != "metrics"
        }


def facts_of(evaluation: Any) -> tuple[str, ...]:
    """Return the facts for the `repr` of an `Evaluation` or its summary."""
    metrics = evaluation.metrics
    return (
        counted(evaluation.queries, "query", "queries"),
        counted(len(evaluation.classes), "class", "classes"),
        f"accuracy {evaluation.accuracy:.3g}",
        "" if metrics is None else f"mean average precision {metrics.map:.3g}",
        noted(evaluation.unanswered, "unanswered query", "unanswered queries"),
    )


def _metrics_of(values: Mapping[str, Any]) -> RetrievalMetrics | None:
    found = [values[name] for name in _METRICS]
    return None if None in found else RetrievalMetrics(*found)


def _metrics_as_dict(metrics: RetrievalMetrics | None) -> dict[str, float | None]:
    return asdict(metrics) if metrics else dict.fromkeys(_METRICS)
