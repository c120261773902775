"""How far classes are apart: in a measure (Fig. 8), and over the number of dimensions (Fig. 5)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import combinations
from typing import Any

import numpy as np

from unbend.arrays import Floats


@dataclass(frozen=True)
class Clusters:
    """How far a measure keeps the classes apart: Fig. 8 as numbers."""

    nearest: float | None
    """How often the nearest other shape is of the same class, of the shapes whose class has another member."""
    ratio: float | None
    """Mean distance between classes over that within: None without either, or where that within is 0."""


def clusters(distances: Floats, labels: Sequence[str]) -> Clusters:
    """Return how far classes are apart under `distances` (n, n) between shapes of the classes `labels`."""
    names = np.array(labels)
    same, other = names[:, None] == names, ~np.eye(len(names), dtype=bool)
    within, between = distances[same & other], distances[~same]
    asked = (same & other).any(axis=1)
    nearest = np.where(other, distances, np.inf).argmin(axis=1) if len(names) > 1 else np.zeros(len(names), np.int64)
    return Clusters(
        nearest=float((names[nearest] == names)[asked].mean()) if asked.any() else None,
        ratio=float(between.mean() / within.mean()) if len(between) and len(within) and within.any() else None,
    )


@dataclass(frozen=True)
class Separation:
    """How far pairs of classes are apart over the number of dimensions, 1 first: Fig. 5."""

    pairs: Sequence[tuple[str, str]]
    """Of classes of two members or more."""
    ratios: Mapping[str, Sequence[Sequence[float]]]
    """By method: for each number of dimensions the log ratio of each pair."""

    @property
    def medians(self) -> dict[str, list[float]]:
        """The median over the pairs, by method: one number for each number of dimensions."""
        return {method: [float(np.median(row)) for row in rows] for method, rows in self.ratios.items()}

    def as_dict(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return asdict(self) | {"medians": self.medians}


def separation(vectors: Mapping[str, Floats], labels: Sequence[str]) -> Separation:
    """Return how far classes are apart over the number of dimensions.

    Parameters
    ----------
    vectors : mapping of str to (n, m, d) float64
        By method: for each shape, in 1 to m dimensions, the vector that stands for it.
    labels : sequence of str, (n,)
        Classes; those of a single shape are left out, for they have no variance.

    Returns
    -------
    Separation
        Natural logarithms of the squared distance between two classes' means over the sum of their variances (Fig. 5).
        A variance of 0 counts as a millionth of a millionth of the squared distance.
    """
    names = np.array(labels)
    members = {label: names == label for label in dict.fromkeys(labels)}
    pairs = [pair for pair in combinations(members, 2) if all(members[label].sum() > 1 for label in pair)]
    ratios = {
        method: [[log_ratio(*(row[members[label]] for label in pair)) for pair in pairs] for row in of.swapaxes(0, 1)]
        for method, of in vectors.items()
    }
    return Separation(pairs, ratios)


def log_ratio(a: Floats, b: Floats) -> float:
    """Return the log ratio of two classes of vectors, (n, d) and (k, d)."""
    apart = ((a.mean(axis=0) - b.mean(axis=0)) ** 2).sum()
    spread = sum(((of - of.mean(axis=0)) ** 2).sum(axis=1).mean() for of in (a, b))
    return float(np.log(max(apart, np.finfo(float).tiny) / max(spread, 1e-12 * apart, np.finfo(float).tiny)))
