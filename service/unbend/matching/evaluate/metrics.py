"""Retrieval metrics, as the Princeton Shape Benchmark defines them (Shilane et al. 2004, section 4.2).

Precision over recall is interpolated as the benchmark's psbPlot does.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from unbend.arrays import Floats, Ints
from unbend.brief import brief, counted

_E_MEASURE_RANK: Final = 32

RECALL_LEVELS: Final = 20
"""Number of levels: recall of 1/20, 2/20 ... 1, as in psbPlot. At recall 0 there is no precision."""


@dataclass(frozen=True)
class RetrievalMetrics:
    """Means over queries. All except `e` are 1 if every query's class comes first."""

    nn: float
    """Nearest neighbour: the share of queries whose nearest shape belongs to their class."""
    ft: float
    """First tier: the share of the class, which has C members besides the query, that is among the C nearest."""
    st: float
    """Second tier: the share of the class that is among the 2 C nearest."""
    e: float
    """E-measure: the harmonic mean of precision and recall among the 32 nearest."""
    dcg: float
    """Discounted cumulative gain, divided by the gain of the ideal ranking."""
    map: float
    """Mean average precision."""

    @classmethod
    def mean(cls, rows: Floats) -> Self | None:
        """Return the means of the metrics of queries, (q, 6), without rows of NaN; None if all rows are NaN."""
        rows = rows[~np.isnan(rows[:, 0])]
        return cls(*rows.mean(axis=0).tolist()) if len(rows) else None


def rank_metrics(ranks: Ints) -> Floats:
    """Return the metrics of queries whose relevant shapes have these ranks.

    Parameters
    ----------
    ranks : (q, c) int
        The ranks of the c > 0 relevant shapes of each query, from 1 and ascending.

    Returns
    -------
    (q, 6) float64
        In the order of the fields of `RetrievalMetrics`.
    """
    size = ranks.shape[1]
    ideal = np.arange(1, size + 1)
    hits = (ranks <= _E_MEASURE_RANK).sum(axis=1)
    return np.column_stack(
        [
            ranks[:, 0] == 1,
            (ranks <= size).mean(axis=1),
            (ranks <= 2 * size).mean(axis=1),
            2.0 * hits / (_E_MEASURE_RANK + size),  # 2 / (1 / P + 1 / R), where P = hits / 32 and R = hits / size
            _gain(ranks).sum(axis=1) / _gain(ideal).sum(),
            (ideal / ranks).mean(axis=1),
        ]
    )


def _gain(ranks: Ints) -> Floats:
    """Return the discounted gain: 1 for the first rank, and 1 / log2(i) for rank i."""
    return np.asarray(1.0 / np.maximum(1.0, np.log2(ranks)))


@dataclass(frozen=True)
class PrecisionRecall:
    """Mean precision at levels of recall, over the queries that have a precision there.

    A query whose class has c members has a precision at recall 1/c, 2/c ... 1. Between these levels precision is
    interpolated linearly. Below 1/c it is undefined. Levels at which no query has a precision are left out, so low
    levels describe only large classes.
    """

    recall: tuple[float, ...]
    precision: tuple[float, ...]

    def __repr__(self) -> str:
        return brief(
            self, counted(len(self.recall), "level"),
            *(f"precision {last:.3g} at full recall" for last in self.precision[-1:]),
        )  # fmt: skip

    @classmethod
    def mean(cls, rows: Floats) -> Self:
        """Return the mean of the precisions of queries, (q, RECALL_LEVELS), ignoring NaN."""
        defined = ~np.isnan(rows)
        counts = defined.sum(axis=0)
        levels = np.flatnonzero(counts)
        sums = np.where(defined, rows, 0.0).sum(axis=0)
        return cls(
            tuple(((levels + 1) / RECALL_LEVELS).tolist()),
            tuple((sums[levels] / counts[levels]).tolist()),
        )


def rank_precision(ranks: Ints) -> Floats:
    """Return precision at the levels of recall, (q, RECALL_LEVELS), of queries whose relevant shapes have these ranks.

    `ranks` is (q, c), as for `rank_metrics`. The precision is NaN at levels below 1/c.
    """
    size = ranks.shape[1]
    precision = np.arange(1, size + 1) / ranks
    # The k-th of c members reaches a level if k = level * c / 20, which lies between two integers.
    below, remainder = np.divmod(np.arange(1, RECALL_LEVELS + 1) * size, RECALL_LEVELS)
    share = remainder / RECALL_LEVELS
    lower = precision[:, np.maximum(below - 1, 0)]
    upper = precision[:, np.minimum(below, size - 1)]
    return np.where(below > 0, (1.0 - share) * lower + share * upper, np.nan)
