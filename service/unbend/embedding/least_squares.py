"""Least squares scaling: SMACOF, iterative majorisation of the stress (section 3.2; Borg & Groenen, ch. 8).

The paper prints the diagonal of B(Z) with the wrong sign and the stopping rule without the decrease; both are
as in Borg & Groenen here.
"""

from __future__ import annotations

import numpy as np

from unbend.arrays import Floats
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
    axes = np.ascontiguousarray(start.T)
    moved, value = _guttman(axes, distances, w)
    made = 0
    for made in range(1, iterations + 1):  # noqa: B007
        axes = moved / len(start) if inverse is None else moved @ inverse  # eq. 9, eq. 8
        previous = value
        moved, value = _guttman(axes, distances, w)
        if previous - value <= decrease * previous:
            break
    return np.ascontiguousarray(axes.T), made


def _laplacian_inverse(weights: Floats) -> Floats:
    """Return V^+ of eq. 8: V plus the constant ones has the same inverse on centred configurations."""
    count = len(weights)
    laplacian = np.diag(weights.sum(axis=1)) - weights
    ones = np.full((count, count), 1.0 / count)
    return np.asarray(np.linalg.inv(laplacian + ones) - ones)


@kernel
def _guttman(axes, distances, weights):
    """Return B(Z) Z and the raw stress of Z (eq. 7), for Z given as (m, n), without any n x n matrix.

    Column j of B(Z) Z is sum_i w_ij delta_ij / d_ij (z_j - z_i). The inner loops run over j and add nothing up
    within themselves, so they are vectorised and yet round in one fixed order.
    """
    dimensions, count = axes.shape
    weighted = weights.shape[0] > 0
    result = np.zeros((dimensions, count))
    loss = np.zeros(count)
    ratio = np.empty(count)
    for i in range(count):
        ratio[:] = 0.0
        for axis in range(dimensions):
            here = axes[axis, i]
            for j in range(count):
                ratio[j] += (axes[axis, j] - here) ** 2
        for j in range(count):
            distance = np.sqrt(ratio[j])
            given = distances[i, j]
            weight = weights[i, j] if weighted else 1.0
            loss[j] += weight * (given - distance) ** 2
            ratio[j] = weight * given / distance if distance > 0.0 else 0.0
        for axis in range(dimensions):
            here = axes[axis, i]
            for j in range(count):
                result[axis, j] += ratio[j] * (axes[axis, j] - here)
    return result, 0.5 * loss.sum()
