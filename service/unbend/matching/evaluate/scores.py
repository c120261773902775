"""The figures of each single query: all follow from the places of its class' members in its ranking."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from unbend.arrays import Codes, Floats, Indices, Singles
from unbend.errors import ParameterError
from unbend.matching.evaluate.curves import LEVELS, rank_precision
from unbend.matching.evaluate.figures import RetrievalFigures, rank_figures

_BLOCK: Final = 1 << 20  # distances sorted at a time: some megabytes


@dataclass(frozen=True)
class Scores:
    """A row for each query; NaN where its class has no member that it could find."""

    figures: Floats
    """(q, 6), in the order of `RetrievalFigures`' fields."""
    precision: Floats
    """(q, LEVELS)."""
    nearest: Indices
    """Row of the gallery, (q,)."""


def score(distances: Floats | Singles, queries: Codes, gallery: Codes, own: Indices | None) -> Scores:
    """Rank the gallery for every query.

    Parameters
    ----------
    distances : (q, n) float64 or float32
    queries, gallery : (q,) and (n,) int32
        Classes.
    own : (q,) int64, optional
        Row of the gallery that is the query itself, and of its class; it is left out.

    Raises
    ------
    ParameterError
        If a distance is NaN.
    """
    figures = np.full((len(queries), len(RetrievalFigures.__dataclass_fields__)), np.nan)
    precision = np.full((len(queries), LEVELS), np.nan)
    nearest = np.empty(len(queries), np.int64)
    for rows in _blocks(queries, max(1, _BLOCK // len(gallery))):
        order = _order(distances, rows, own)
        nearest[rows] = order[:, 0]
        relevant = gallery[order] == queries[rows[0]]
        # all of a block are of one class, so each finds as many members
        ranks = np.nonzero(relevant)[1].reshape(len(rows), -1) + 1
        if ranks.size:
            figures[rows], precision[rows] = rank_figures(ranks), rank_precision(ranks)
    return Scores(figures, precision, nearest)


def _blocks(codes: Codes, length: int) -> Iterator[Indices]:
    """Yield rows of one class, at most `length` at a time."""
    by_class = np.argsort(codes, kind="stable")
    starts = np.flatnonzero(np.diff(codes[by_class])) + 1
    for rows in np.split(by_class, starts):
        for start in range(0, len(rows), length):
            yield rows[start : start + length]


def _order(distances: Floats | Singles, rows: Indices, own: Indices | None) -> Indices:
    """Return the gallery's rows without a query's own, nearest first, equally near ones in their order."""
    block = distances[rows]
    if own is not None:
        others = np.arange(block.shape[1]) != own[rows, None]
        block = block[others].reshape(len(rows), -1)
    order = np.argsort(block, axis=1)
    ordered = np.take_along_axis(block, order, axis=1)
    if np.isnan(ordered[:, -1]).any():  # NaN is sorted behind all numbers
        raise ParameterError(f"a distance of query {rows[np.isnan(ordered[:, -1])][0]} is not a number")
    # The quick sort is several times as fast as the stable one, which is needed only where distances are equal.
    tied = (ordered[:, 1:] == ordered[:, :-1]).any(axis=1)
    if tied.any():
        order[tied] = np.argsort(block[tied], axis=1, kind="stable")
    return order if own is None else order + (order >= own[rows, None])
