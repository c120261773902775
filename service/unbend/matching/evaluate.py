"""Retrieval figures, as the Princeton Shape Benchmark defines them (Shilane et al. 2004, section 4.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from unbend.arrays import Bools, Floats, Ints
from unbend.errors import ParameterError

E_MEASURE_RANK: Final = 32


@dataclass(frozen=True)
class RetrievalFigures:
    """Means over all queries; each is 1 when every query's class comes first."""

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


def leave_one_out(distances: Floats, labels: Sequence[str]) -> RetrievalFigures:
    """Rank all other shapes for each shape and average the figures.

    Parameters
    ----------
    distances : (n, n) float64
        Row i: from query i. The diagonal is not looked at.
    labels : sequence of n str

    Raises
    ------
    ParameterError
        If no class has two members, for then there is nothing to retrieve.
    """
    classes = np.unique(np.asarray(labels), return_inverse=True)[1]
    if len(classes) != len(distances) or distances.shape != (len(classes), len(classes)):
        raise ParameterError(f"{len(classes)} labels for distances of shape {distances.shape}")
    figures = [
        _query_figures(relevant)
        for query in range(len(classes))
        if (relevant := _relevance(distances[query], classes, query)).any()
    ]
    if not figures:
        raise ParameterError("no class has two members: there is nothing to retrieve")
    return RetrievalFigures(*np.mean(figures, axis=0).tolist())


def nearest_class_accuracy(nearest: Sequence[str | None], labels: Sequence[str]) -> float:
    """Return the share of queries whose nearest class is their own; a query without an answer counts as wrong."""
    if not labels:
        raise ParameterError("there are no queries")
    return sum(found == label for found, label in zip(nearest, labels, strict=True)) / len(labels)


def _relevance(row: Floats, classes: Ints, query: int) -> Bools:
    order = np.argsort(row, kind="stable")
    order = order[order != query]
    return np.asarray(classes[order] == classes[query])


def _query_figures(relevant: Bools) -> tuple[float, ...]:
    size = int(relevant.sum())
    ranks = np.arange(1, len(relevant) + 1)
    found = np.cumsum(relevant)
    # DCG: the first place counts fully, place i by 1 / log2(i)
    discount = 1.0 / np.maximum(1.0, np.log2(ranks))
    hits = int(found[min(E_MEASURE_RANK, len(found)) - 1])
    precision, recall = hits / E_MEASURE_RANK, hits / size
    return (
        float(relevant[0]),
        float(found[size - 1] / size),
        float(found[min(2 * size, len(found)) - 1] / size),
        2.0 / (1.0 / precision + 1.0 / recall) if hits else 0.0,
        float((relevant * discount).sum() / discount[:size].sum()),
        float((found / ranks)[relevant].mean()),
    )
