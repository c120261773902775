"""FastMap (Faloutsos & Lin 1995; section 3.3): one axis after another through two distant points."""

from __future__ import annotations

import numpy as np

from unbend.arrays import Floats

_PIVOT_ROUNDS = 5  # steps to the farthest point from the current one; Faloutsos & Lin use the same number


def fastmap(distances: Floats, dimensions: int) -> tuple[Floats, int]:
    """Embed by FastMap, which reads only O(n m) distances.

    Parameters
    ----------
    distances : (n, n) float64
    dimensions : int

    Returns
    -------
    points : (n, dimensions) float64
        Columns beyond the rank of the distances are zero.
    clipped : int
        Number of negative squared residuals (eq. 10), which are replaced by zero. Geodesic distances can have such
        residuals.
    """
    points = np.zeros((len(distances), dimensions))
    clipped = 0
    for axis in range(dimensions):
        pivot = 0
        for _ in range(_PIVOT_ROUNDS):
            squared, negative = _residual(distances, points[:, :axis], pivot)
            clipped += negative
            pivot, previous = int(squared.argmax()), pivot
        from_b, negative_b = _residual(distances, points[:, :axis], pivot)
        from_a, negative_a = _residual(distances, points[:, :axis], previous)
        clipped += negative_a + negative_b
        between = from_a[pivot]
        if between <= 0.0:
            break
        points[:, axis] = (from_a + between - from_b) / (2.0 * np.sqrt(between))  # the cosine law
    return points - points.mean(axis=0), clipped


def _residual(distances: Floats, points: Floats, pivot: int) -> tuple[Floats, int]:
    """Return squared distances to `pivot` orthogonal to the previous axes, clipped at 0, and the number clipped."""
    squared = distances[pivot] ** 2 - ((points - points[pivot]) ** 2).sum(axis=1)
    negative = int((squared < -1e-12 * (distances[pivot] ** 2).max(initial=0.0)).sum())
    return np.maximum(squared, 0.0), negative
