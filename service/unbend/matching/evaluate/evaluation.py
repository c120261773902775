"""Evaluation of retrieval under one measure: overall, per class and as a confusion matrix."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from unbend.arrays import Codes, Floats, Indices, Singles, frozen
from unbend.brief import brief
from unbend.errors import ParameterError, UnsuitedError
from unbend.matching.evaluate.metrics import PrecisionRecall, RetrievalMetrics
from unbend.matching.evaluate.scores import Scores, score
from unbend.matching.evaluate.summary import ClassMetrics, Confusion, EvaluationSummary, facts_of

_MAX_CONFUSION_CLASSES: Final = 1000
"""Largest number of classes for which a summary has the confusion matrix: n classes need n^2 counts."""


@dataclass(frozen=True)
class Evaluation:
    """The results of ranking a gallery for each of several queries."""

    metrics: RetrievalMetrics | None
    """Means over the queries whose class has another shape in the gallery; None if there are no such queries."""
    accuracy: float
    """The share of all queries whose nearest shape belongs to their class."""
    queries: int
    """The number of queries, including unanswered ones."""
    unanswered: int
    """The number of queries without a signature. They count as wrong in `accuracy`; the metrics ignore them."""
    precision_recall: PrecisionRecall
    classes: tuple[ClassMetrics, ...]
    """The classes of the queries, in the order of `labels`."""
    labels: tuple[str, ...]
    """Every class of a query or of the gallery, sorted."""
    query_classes: Codes
    """Index into `labels` of the class of each answered query, (q,). The following arrays have the same rows."""
    nearest_classes: Codes
    """Index into `labels` of the class of the nearest shape, (q,)."""
    nearest: Indices
    """Row in the gallery of the nearest shape, (q,)."""
    nearest_distances: Floats
    """Distance to the nearest shape, (q,)."""

    def __repr__(self) -> str:
        return brief(self, *facts_of(self))

    @property
    def confusion(self) -> Indices:
        """Counts of queries by class (row) and class of the nearest shape (column), ordered as `labels`, (k, k)."""
        size = len(self.labels)
        pairs = self.query_classes.astype(np.int64) * size + self.nearest_classes
        return np.bincount(pairs, minlength=size * size).reshape(size, size)

    @property
    def wrong(self) -> Indices:
        """The rows of the queries whose nearest shape belongs to another class."""
        return np.flatnonzero(self.query_classes != self.nearest_classes)

    @property
    def summary(self) -> EvaluationSummary:
        """The results without the rows of single queries. For more than 1000 classes, it has no confusion matrix."""
        confusion = None
        if len(self.labels) <= _MAX_CONFUSION_CLASSES:
            confusion = Confusion(self.labels, tuple(map(tuple, self.confusion.tolist())))
        return EvaluationSummary(
            self.metrics, self.accuracy, self.queries, self.unanswered, self.classes, confusion, self.precision_recall
        )

    def as_dict(self) -> dict[str, Any]:
        """Return the summary as plain JSON values."""
        return self.summary.as_dict()


def evaluate(
    distances: Floats | Singles,
    query_labels: Sequence[str],
    gallery_labels: Sequence[str],
    *,
    own: Indices | None = None,
    unanswered: Sequence[str] = (),
) -> Evaluation:
    """Rank the gallery for every query and average the metrics.

    Shapes at equal distances are ranked in the order of their rows. Queries whose class has no other shape in the
    gallery have nothing to retrieve. They are left out of the metrics and of precision over recall, but count as wrong
    in `accuracy`.

    Parameters
    ----------
    distances : (q, n) float64 or float32
        Row i has the distances from query i to the gallery.
    query_labels, gallery_labels : sequences of q and n str
    own : (q,) int64, optional
        For leave-one-out: the row of the gallery that is the query itself. This row is left out of the query's ranking.
        By default no query is in the gallery.
    unanswered : sequence of str
        Classes of further queries, which have no signature and count as wrong.

    Raises
    ------
    ParameterError
        If sizes do not match, a distance is NaN, or there is no query or no gallery.
    UnsuitedError
        With `own`, if no class has two members, because then there is nothing to retrieve.

    References
    ----------
    Shilane, Min, Kazhdan, Funkhouser: The Princeton Shape Benchmark. Shape Modeling International 2004, section 4.2.
    """
    labels = tuple(sorted({*query_labels, *gallery_labels, *unanswered}))
    code_of = {label: code for code, label in enumerate(labels)}
    queries, gallery, failed = (
        np.array([code_of[label] for label in some], np.int32) for some in (query_labels, gallery_labels, unanswered)
    )
    _check(distances, (queries, gallery, failed), own)
    scores = score(distances, queries, gallery, own)
    nearest_classes = gallery[scores.nearest]
    return Evaluation(
        metrics=RetrievalMetrics.mean(scores.metrics),
        accuracy=float((nearest_classes == queries).sum() / (len(queries) + len(failed))),
        queries=len(queries) + len(failed),
        unanswered=len(failed),
        precision_recall=PrecisionRecall.mean(scores.precision),
        classes=_class_metrics(scores, labels, (queries, gallery, failed)),
        labels=labels,
        query_classes=frozen(queries, np.int32),
        nearest_classes=frozen(nearest_classes, np.int32),
        nearest=frozen(scores.nearest, np.int64),
        nearest_distances=frozen(distances[np.arange(len(queries)), scores.nearest], np.float64),
    )


def _class_metrics(
    scores: Scores, labels: tuple[str, ...], codes: tuple[Codes, Codes, Codes]
) -> tuple[ClassMetrics, ...]:
    queries, gallery, failed = codes
    right = queries[gallery[scores.nearest] == queries]
    answered, members, unanswered, correct = (
        np.bincount(some, minlength=len(labels)).tolist() for some in (queries, gallery, failed, right)
    )
    return tuple(
        ClassMetrics(
            label=label,
            queries=answered[code] + unanswered[code],
            members=members[code],
            accuracy=correct[code] / (answered[code] + unanswered[code]),
            metrics=RetrievalMetrics.mean(scores.metrics[queries == code]),
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
        raise ParameterError(f"own must be a row of the gallery (0 to {len(gallery) - 1}) for each query")
    if (gallery[own] != queries).any():
        raise ParameterError(f"query {np.flatnonzero(gallery[own] != queries)[0]} has another class in the gallery")
    if not (np.bincount(gallery)[queries] > 1).any():
        raise UnsuitedError("no class has two members: there is nothing to retrieve")
