"""Least squares scaling: SMACOF, iterative majorisation of the stress (section 3.2; Borg & Groenen, ch. 8).

The paper prints the diagonal of B(Z) with the wrong sign and the stopping rule without the decrease; both are
as in Borg & Groenen here.
"""

from __future__ import annotations

import numpy as np

from unbend.arrays import Floats
from unbend.embedding.stress import raw_stress
from unbend.jit import kernel
from unbend.tolerances import SMACOF_DECREASE, SMACOF_ITERATIONS

_ONES = np.empty((0, 0))


def smacof(
    distances: Floats,
    start: Floats,
    weights: Floats | None = None,
    *,
    decrease: float = SMACOF_DECREASE,
    iterations: int = SMACOF_ITERATIONS,
) -> tuple[Floats, int]:
    """Lower the stress of `start` until an iteration gains less than `decrease` of it.

    Parameters
    ----------
    distances : (n, n) float64
    start : (n, m) float64
        Where to begin; the classical solution is a good choice.
    weights : (n, n) float64, optional
        Symmetric, not negative; ones by default. The pairs with a weight must connect all points.
    decrease : float
        Share of the stress below which an iteration's gain ends the search.
    iterations : int
        Most iterations made.

    Returns
    -------
    points : (n, m) float64
        The last configuration; its stress is never above that of `start`.
    iterations : int
        How many were made.
    """
    w = _ONES if weights is None else weights
    inverse = None if weights is None else _laplacian_inverse(weights)
    points = start - start.mean(axis=0)
    value = raw_stress(points, distances, w)
    made = 0
    for made in range(1, iterations + 1):
        moved = _guttman(points, distances, w)
        points = moved / len(points) if inverse is None else inverse @ moved  # eq. 9, eq. 8
        previous, value = value, raw_stress(points, distances, w)
        if previous - value <= decrease * previous:
            break
    return points, made


def _laplacian_inverse(weights: Floats) -> Floats:
    """Return V^+ of eq. 8: V plus the constant ones has the same inverse on centred configurations."""
    count = len(weights)
    laplacian = np.diag(weights.sum(axis=1)) - weights
    ones = np.full((count, count), 1.0 / count)
    return np.asarray(np.linalg.inv(laplacian + ones) - ones)


@kernel
def _guttman(points, distances, weights):  # type: ignore[no-untyped-def]
    """Return B(Z) Z, row by row: row i is sum_j w_ij delta_ij / d_ij (z_i - z_j), without any n x n matrix."""
    count, dimensions = points.shape
    weighted = weights.shape[0] > 0
    result = np.zeros((count, dimensions))
    for i in range(count):
        for j in range(count):
            squared = 0.0
            for axis in range(dimensions):
                squared += (points[i, axis] - points[j, axis]) ** 2
            if squared > 0.0:
                ratio = distances[i, j] / np.sqrt(squared)
                if weighted:
                    ratio *= weights[i, j]
                for axis in range(dimensions):
                    result[i, axis] += ratio * (points[i, axis] - points[j, axis])
    return result
