"""Precision at standard levels of recall, interpolated as the Princeton Shape Benchmark's psbPlot does."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from unbend.arrays import Floats, Ints

LEVELS: Final = 20
"""Recall of 1/20, 2/20 ... 1, as psbPlot has it. At recall 0 there is no precision."""


@dataclass(frozen=True)
class PrecisionRecall:
    """Mean precision at levels of recall, over the queries that have one there.

    A query whose class has c members knows precision at recall 1/c, 2/c ... 1. Between those it is interpolated
    linearly; below 1/c it has none. Levels that no query reaches down to are left out, so low ones tell of large
    classes only.
    """

    recall: tuple[float, ...]
    precision: tuple[float, ...]

    @classmethod
    def mean(cls, rows: Floats) -> Self:
        """Return the mean of the queries' precisions, (q, LEVELS), NaN where there is none."""
        known = ~np.isnan(rows)
        counts = known.sum(axis=0)
        levels = np.flatnonzero(counts)
        sums = np.where(known, rows, 0.0).sum(axis=0)
        return cls(
            tuple(((levels + 1) / LEVELS).tolist()),
            tuple((sums[levels] / counts[levels]).tolist()),
        )


def rank_precision(ranks: Ints) -> Floats:
    """Return precision at the levels of recall, (q, LEVELS), of queries whose relevant shapes come at these places.

    `ranks` is (q, c), from 1 and ascending, as for `rank_figures`. NaN where the level is below 1/c.
    """
    size = ranks.shape[1]
    precision = np.arange(1, size + 1) / ranks
    # a level is that of the k-th of c members for k = level * c / 20, which lies between two whole numbers
    below, rest = np.divmod(np.arange(1, LEVELS + 1) * size, LEVELS)
    share = rest / LEVELS
    lower = precision[:, np.maximum(below - 1, 0)]
    upper = precision[:, np.minimum(below, size - 1)]
    return np.where(below > 0, (1.0 - share) * lower + share * upper, np.nan)
