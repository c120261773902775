"""Everything that is measured of retrieval with one measure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any, Final, cast

import numpy as np

from unbend.arrays import Codes, Floats, Indices, Singles, frozen
from unbend.errors import ParameterError, UnsuitedError
from unbend.matching.evaluate.curves import PrecisionRecall
from unbend.matching.evaluate.figures import RetrievalFigures
from unbend.matching.evaluate.scores import Scores, score

_MOST_CONFUSED: Final = 1000
"""Classes whose confusions are told: there are as many numbers as the square of that."""


@dataclass(frozen=True)
class ClassFigures:
    """The queries of one class."""

    label: str
    queries: int
    """Those without an answer too."""
    members: int
    """Shapes of the class in the gallery; when one is left out, it is counted."""
    accuracy: float
    """How often the nearest shape is of this class; a query without an answer counts as wrong."""
    figures: RetrievalFigures | None
    """None where no query has another shape of the class in the gallery."""

    def as_dict(self) -> dict[str, Any]:
        """Return plain JSON values, the figures beside the rest; they are None where there are none."""
        counts = {name: getattr(self, name) for name in ("label", "queries", "members", "accuracy")}
        return counts | _figures_as_dict(self.figures)


@dataclass(frozen=True)
class Evaluation:
    """How well queries find shapes of their class in a gallery."""

    figures: RetrievalFigures | None
    """Over the queries whose class has another shape in the gallery; None where there are none."""
    accuracy: float
    """How often the nearest shape is of the query's class; over all queries."""
    queries: int
    """Those without an answer too."""
    unanswered: int
    """Queries that had no signature: wrong, and part of nothing but `accuracy`."""
    precision_recall: PrecisionRecall
    classes: tuple[ClassFigures, ...]
    """The queries' classes, in the order of `labels`."""
    labels: tuple[str, ...]
    """Every class of a query or of the gallery, sorted."""
    query_classes: Codes
    """Place in `labels`, (q,), of each query that has an answer; so are the following."""
    nearest_classes: Codes
    """Of the nearest shape, (q,)."""
    nearest: Indices
    """The nearest shape's row in the gallery, (q,)."""
    nearest_distances: Floats
    """(q,)."""

    @property
    def confusion(self) -> Indices:
        """Queries by their class (row) and that of the nearest shape (column), in the order of `labels`, (k, k)."""
        size = len(self.labels)
        pairs = self.query_classes.astype(np.int64) * size + self.nearest_classes
        return np.bincount(pairs, minlength=size * size).reshape(size, size)

    @property
    def wrong(self) -> Indices:
        """The queries, as rows of the distances, whose nearest shape is of another class."""
        return np.flatnonzero(self.query_classes != self.nearest_classes)

    def as_dict(self) -> dict[str, Any]:
        """Return plain JSON values; the figures stand beside the rest. No confusion of more than 1000 classes."""
        return _figures_as_dict(self.figures) | {
            "accuracy": self.accuracy,
            "queries": self.queries,
            "unanswered": self.unanswered,
            "classes": [row.as_dict() for row in self.classes],
            "confusion": self._confusion_as_dict(),
            "precision_recall": {
                "recall": list(self.precision_recall.recall),
                "precision": list(self.precision_recall.precision),
            },
        }

    def _confusion_as_dict(self) -> dict[str, Any] | None:
        if len(self.labels) > _MOST_CONFUSED:
            return None
        return {"labels": list(self.labels), "counts": self.confusion.tolist()}


def evaluate(
    distances: Floats | Singles,
    query_labels: Sequence[str],
    gallery_labels: Sequence[str],
    *,
    own: Indices | None = None,
    unanswered: Sequence[str] = (),
) -> Evaluation:
    """Rank the gallery for every query and average the figures.

    Shapes at equal distances are ranked in the order of their rows. Queries whose class has no other shape in the
    gallery have nothing to retrieve: they are left out of the figures and of precision and recall, and are wrong
    in `accuracy`.

    Parameters
    ----------
    distances : (q, n) float64 or float32
        Row i: from query i to the gallery.
    query_labels, gallery_labels : sequences of q and n str
    own : (q,) int64, optional
        Leave-one-out: row of the gallery that is the query itself. It is left out; its distance is not looked at.
        By default no query is in the gallery.
    unanswered : sequence of str
        Classes of further queries, that have no signature: they count as wrong answers.

    Raises
    ------
    ParameterError
        If sizes do not fit, a distance is NaN, there is no query or no gallery; UnsuitedError, with `own`, if no
        class has two members, for then there is nothing to retrieve.

    References
    ----------
    Shilane, Min, Kazhdan, Funkhouser: The Princeton Shape Benchmark. Shape Modeling International 2004, section 4.2.
    """
    labels = tuple(sorted({*query_labels, *gallery_labels, *unanswered}))
    places = {label: place for place, label in enumerate(labels)}
    queries, gallery, failed = (
        np.array([places[label] for label in some], np.int32) for some in (query_labels, gallery_labels, unanswered)
    )
    _check(distances, (queries, gallery, failed), own)
    scores = score(distances, queries, gallery, own)
    found = gallery[scores.nearest]
    return Evaluation(
        figures=RetrievalFigures.mean(scores.figures),
        accuracy=float((found == queries).sum() / (len(queries) + len(failed))),
        queries=len(queries) + len(failed),
        unanswered=len(failed),
        precision_recall=PrecisionRecall.mean(scores.precision),
        classes=_class_figures(scores, labels, (queries, gallery, failed)),
        labels=labels,
        query_classes=frozen(queries, np.int32),
        nearest_classes=frozen(found, np.int32),
        nearest=frozen(scores.nearest, np.int64),
        nearest_distances=frozen(distances[np.arange(len(queries)), scores.nearest], np.float64),
    )


def leave_one_out(distances: Floats | Singles, labels: Sequence[str]) -> RetrievalFigures:
    """Rank all other shapes for each shape and average the figures.

    Parameters
    ----------
    distances : (n, n) float64 or float32
        Row i: from query i. The diagonal is not looked at.
    labels : sequence of n str

    Raises
    ------
    ParameterError
        If sizes do not fit, or a distance is NaN; UnsuitedError if no class has two members, for then there is
        nothing to retrieve.
    """
    evaluation = evaluate(distances, labels, labels, own=np.arange(len(labels)))
    return cast("RetrievalFigures", evaluation.figures)  # there are some, or `evaluate` had refused


def _class_figures(
    scores: Scores, labels: tuple[str, ...], codes: tuple[Codes, Codes, Codes]
) -> tuple[ClassFigures, ...]:
    queries, gallery, failed = codes
    right = queries[gallery[scores.nearest] == queries]
    answered, members, unanswered, correct = (
        np.bincount(some, minlength=len(labels)).tolist() for some in (queries, gallery, failed, right)
    )
    return tuple(
        ClassFigures(
            label=label,
            queries=answered[code] + unanswered[code],
            members=members[code],
            accuracy=correct[code] / (answered[code] + unanswered[code]),
            figures=RetrievalFigures.mean(scores.figures[queries == code]),
        )
        for code, label in enumerate(labels)
        if answered[code] + unanswered[code]
    )


def _check(distances: Floats | Singles, codes: tuple[Codes, Codes, Codes], own: Indices | None) -> None:
    queries, gallery, failed = codes
    if distances.shape != (len(queries), len(gallery)):
        raise ParameterError(
            f"{len(queries)} labels of queries and {len(gallery)} labels of the gallery "
            f"for distances of shape {distances.shape}"
        )
    if own is not None:
        _check_own(own, queries, gallery)
    elif not len(gallery):
        raise ParameterError("the gallery is empty")
    elif not len(queries) + len(failed):
        raise ParameterError("there are no queries")


def _check_own(own: Indices, queries: Codes, gallery: Codes) -> None:
    if own.shape != queries.shape or ((own < 0) | (own >= len(gallery))).any():
        raise ParameterError(f"own must be a row of the gallery (0 to {len(gallery) - 1}) for each of the queries")
    if (gallery[own] != queries).any():
        raise ParameterError(f"query {np.flatnonzero(gallery[own] != queries)[0]} is of another class in the gallery")
    if not (np.bincount(gallery)[queries] > 1).any():
        raise UnsuitedError("no class has two members: there is nothing to retrieve")


def _figures_as_dict(figures: RetrievalFigures | None) -> dict[str, float | None]:
    return asdict(figures) if figures else dict.fromkeys(field.name for field in fields(RetrievalFigures))
