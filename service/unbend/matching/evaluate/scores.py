"""The metrics of each single query, computed from the ranks of the members of its class."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from unbend.arrays import Codes, Floats, Indices, Singles
from unbend.errors import ParameterError
from unbend.matching.evaluate.metrics import RECALL_LEVELS, RetrievalMetrics, rank_metrics, rank_precision

_BLOCK: Final = 1 << 20  # number of distances that are sorted at once: some megabytes


@dataclass(frozen=True)
class Scores:
    """One row for each query. Metrics and precision are NaN if the gallery has no other member of its class."""

    metrics: Floats
    """(q, 6), in the order of the fields of `RetrievalMetrics`."""
    precision: Floats
    """(q, RECALL_LEVELS)."""
    nearest: Indices
    """The nearest row of the gallery, (q,)."""


def score(distances: Floats | Singles, queries: Codes, gallery: Codes, own: Indices | None) -> Scores:
    """Rank the gallery for every query.

    Parameters
    ----------
    distances : (q, n) float64 or float32
    queries, gallery : (q,) and (n,) int32
        Classes.
    own : (q,) int64, optional
        Row of the gallery that is the query itself, which is left out of the ranking.

    Raises
    ------
    ParameterError
        If a distance is NaN.
    """
    metrics = np.full((len(queries), len(RetrievalMetrics.__dataclass_fields__)), np.nan)
    precision = np.full((len(queries), RECALL_LEVELS), np.nan)
    nearest = np.empty(len(queries), np.int64)
    for rows in _blocks(queries, max(1, _BLOCK // len(gallery))):
        order = _order(distances, rows, own)
        nearest[rows] = order[:, 0]
        relevant = gallery[order] == queries[rows[0]]
        # All queries in a block have one class, so they have the same number of relevant shapes.
        ranks = np.nonzero(relevant)[1].reshape(len(rows), -1) + 1
        if ranks.size:
            metrics[rows], precision[rows] = rank_metrics(ranks), rank_precision(ranks)
    return Scores(metrics, precision, nearest)


def _blocks(codes: Codes, length: int) -> Iterator[Indices]:
    """Yield blocks of at most `length` rows of the same class."""
    by_class = np.argsort(codes, kind="stable")
    starts = np.flatnonzero(np.diff(codes[by_class])) + 1
    for rows in np.split(by_class, starts):
        for start in range(0, len(rows), length):
            yield rows[start : start + length]


def _order(distances: Floats | Singles, rows: Indices, own: Indices | None) -> Indices:
    """Return the rows of the gallery without the query itself, nearest first. Ties keep their order."""
    block = distances[rows]
    if own is not None:
        others = np.arange(block.shape[1]) != own[rows, None]
        block = block[others].reshape(len(rows), -1)
    order = np.argsort(block, axis=1)
    ordered = np.take_along_axis(block, order, axis=1)
    if np.isnan(ordered[:, -1]).any():  # NaN sorts last
        raise ParameterError(f"a distance of query {rows[np.isnan(ordered[:, -1])][0]} is not a number")
    # The default sort is several times as fast as the stable one, which only ties need.
    tied = (ordered[:, 1:] == ordered[:, :-1]).any(axis=1)
    if tied.any():
        order[tied] = np.argsort(block[tied], axis=1, kind="stable")
    return order if own is None else order + (order >= own[rows, None])
