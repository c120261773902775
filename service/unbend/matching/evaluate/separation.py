"""Separation of classes: under a measure (Fig. 8), and over the number of dimensions (Fig. 5)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import combinations
from typing import Any

import numpy as np

from unbend.arrays import Floats


@dataclass(frozen=True)
class Clusters:
    """Separation of classes under a measure: Fig. 8 as numbers."""

    nearest: float | None
    """The share of shapes whose nearest other shape is of their class. Shapes alone in their class are left out."""
    ratio: float | None
    """The mean distance between classes over the mean distance within classes. None if that is undefined."""


def clusters(distances: Floats, labels: Sequence[str]) -> Clusters:
    """Return the separation of the classes `labels` of n shapes under their `distances` (n, n)."""
    names = np.array(labels)
    same, other = names[:, None] == names, ~np.eye(len(names), dtype=bool)
    within, between = distances[same & other], distances[~same]
    has_partner = (same & other).any(axis=1)
    nearest = np.where(other, distances, np.inf).argmin(axis=1) if len(names) > 1 else np.zeros(len(names), np.int64)
    return Clusters(
        nearest=float((names[nearest] == names)[has_partner].mean()) if has_partner.any() else None,
        ratio=float(between.mean() / within.mean()) if len(between) and len(within) and within.any() else None,
    )


@dataclass(frozen=True)
class Separation:
    """Separation of pairs of classes in 1, 2, ... dimensions: Fig. 5."""

    pairs: Sequence[tuple[str, str]]
    """Pairs of classes with at least two members each."""
    ratios: Mapping[str, Sequence[Sequence[float]]]
    """The log ratio of each pair, for each method and number of dimensions."""

    @property
    def medians(self) -> dict[str, list[float]]:
        """The median over the pairs, for each method and number of dimensions."""
        return {method: [float(np.median(row)) for row in rows] for method, rows in self.ratios.items()}

    def as_dict(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return asdict(self) | {"medians": self.medians}


def separation(vectors: Mapping[str, Floats], labels: Sequence[str]) -> Separation:
    """Return the separation of classes over the number of dimensions.

    Parameters
    ----------
    vectors : mapping of str to (n, m, d) float64
        The vectors of the n shapes in 1 to m dimensions, for each method.
    labels : sequence of str, (n,)
        Classes. Classes with a single shape are left out, because they have no variance.

    Returns
    -------
    Separation
        Natural logarithms of the squared distance between two classes' means over the sum of their variances (Fig. 5).
        If the sum is below 1e-12 times the squared distance, this value replaces it.
    """
    names = np.array(labels)
    members = {label: names == label for label in dict.fromkeys(labels)}
    pairs = [pair for pair in combinations(members, 2) if all(members[label].sum() > 1 for label in pair)]
    ratios = {
        method: [
            [log_ratio(*(rows[members[label]] for label in pair)) for pair in pairs] for rows in stacked.swapaxes(0, 1)
        ]
        for method, stacked in vectors.items()
    }
    return Separation(pairs, ratios)


def log_ratio(a: Floats, b: Floats) -> float:
    """Return the log ratio of two classes of vectors, (n, d) and (k, d)."""
    between = ((a.mean(axis=0) - b.mean(axis=0)) ** 2).sum()
    variance = sum(((rows - rows.mean(axis=0)) ** 2).sum(axis=1).mean() for rows in (a, b))
    return float(np.log(max(between, np.finfo(float).tiny) / max(variance, 1e-12 * between, np.finfo(float).tiny)))
