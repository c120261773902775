"""Retrieval figures, as the Princeton Shape Benchmark defines them (Shilane et al. 2004, section 4.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from unbend.arrays import Floats, Ints
from unbend.errors import ParameterError

E_MEASURE_RANK: Final = 32


@dataclass(frozen=True)
class RetrievalFigures:
    """Means over queries; each is 1 when every query's class comes first."""

    nn: float
    """Nearest neighbour: how often the nearest shape is of the query's class."""
    ft: float
    """First tier: share of the class (C members without the query) among the C nearest."""
    st: float
    """Second tier: the same among the 2 C nearest."""
    e: float
    """E-measure: harmonic mean of precision and recall among the 32 nearest."""
    dcg: float
    """Discounted cumulative gain, over that of the ideal ranking."""
    map: float
    """Mean average precision."""

    @classmethod
    def mean(cls, rows: Floats) -> Self | None:
        """Return the means of the queries' figures, (q, 6), without rows of NaN; None where there are no others."""
        rows = rows[~np.isnan(rows[:, 0])]
        return cls(*rows.mean(axis=0).tolist()) if len(rows) else None


def rank_figures(ranks: Ints) -> Floats:
    """Return the figures of queries whose relevant shapes come at these places.

    Parameters
    ----------
    ranks : (q, c) int
        Places, from 1 and ascending, of the c > 0 relevant shapes in each query's ranking.

    Returns
    -------
    (q, 6) float64
        In the order of `RetrievalFigures`' fields.
    """
    size = ranks.shape[1]
    places = np.arange(1, size + 1)
    hits = (ranks <= E_MEASURE_RANK).sum(axis=1)
    return np.column_stack(
        [
            ranks[:, 0] == 1,
            (ranks <= size).mean(axis=1),
            (ranks <= 2 * size).mean(axis=1),
            2.0 * hits / (E_MEASURE_RANK + size),  # 2 / (1 / P + 1 / R), where P = hits / 32 and R = hits / size
            _gain(ranks).sum(axis=1) / _gain(places).sum(),
            (places / ranks).mean(axis=1),
        ]
    )


def nearest_class_accuracy(nearest: Sequence[str | None], labels: Sequence[str]) -> float:
    """Return the share of queries whose nearest class is their own; a query without an answer counts as wrong."""
    if not labels:
        raise ParameterError("there are no queries")
    return sum(found == label for found, label in zip(nearest, labels, strict=True)) / len(labels)


def _gain(ranks: Ints) -> Floats:
    """Discounted gain: the first place counts fully, place i by 1 / log2(i)."""
    return np.asarray(1.0 / np.maximum(1.0, np.log2(ranks)))
