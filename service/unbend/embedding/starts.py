"""Initial points for least squares scaling, from the lowest of many minima of the stress of a few points.

The stress has many minima. The minimum near the classical solution is often not the lowest, because a limb lies on the
wrong side. A few distant points are enough to find the arrangement of the parts, and many starts with a few points are
cheap. The other points are then placed by their distances to the few.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from unbend.arrays import Floats, Indices
from unbend.embedding.extension import extend
from unbend.embedding.gradient import add_blocks
from unbend.embedding.least_squares import are_equal
from unbend.embedding.stress import stress
from unbend.jit import kernel

FEW: Final = 64
"""Number of points that are embedded from each start."""

TRIES: Final = 10
"""Number of random starts."""

DIFFERENT: Final = 6
"""Number of lowest minima of the few points that are extended to all points."""

KEPT: Final = 2
"""Number of extended minima that are returned, those of lowest stress over all points."""

_SAME: Final = 1e-3
"""Minima whose values differ by less than this share count as equal."""

_STEPS: Final = 120
"""Maximum number of steps from one start."""

_DECREASE: Final = 1e-4
"""Share of the stress. The search ends when two successive steps lower the stress by less."""


def low_starts(distances: Floats, classical: Floats, weights: Floats | None = None, seed: int = 0) -> list[Floats]:
    """Return sets of points, (n, m), near low minima of the stress, the set of lowest stress first.

    Parameters
    ----------
    distances : (n, n) float64
    classical : (n, m) float64
        The classical solution, an additional start of the few points.
    weights : (n, n) float64, optional
        Weights of pairs; ones by default. If the weights of the few points do not connect them, equal weights are used.
    seed : int
        Seed of the random starts.
    """
    few = _far_points(distances, min(FEW, len(distances)))
    between: Floats = np.ascontiguousarray(distances[few][:, few])
    scale = float(between.max()) or 1.0
    given, pairs, inverse = (between / scale).astype(np.float32), *_metric(weights, few)
    minima: list[tuple[float, NDArray[np.float32]]] = []
    for start in (classical[few], *random_points(between, classical.shape[1], TRIES, seed)):
        axes = np.ascontiguousarray((start - start.mean(axis=0)).T / scale).astype(np.float32)
        minima.append((_descend(axes, given, pairs, inverse, _STEPS, np.float32(_DECREASE)), axes))
    different = list(_different(minima))
    squared = ((distances[few] / scale) ** 2).astype(np.float32)
    placed = scale * _placed(np.concatenate(different), few, squared)
    found = np.split(placed, len(different), axis=1)
    return sorted(found, key=lambda points: stress(points, distances, weights))[:KEPT]


def _placed(axes: NDArray[np.float32], few: Indices, squared: NDArray[np.float32]) -> Floats:
    """Return all points, in the unit of `axes` (m, k), placed by their squared distances (k, n) to the few points."""
    points: Floats = np.ascontiguousarray(axes.T).astype(np.float64)
    if len(few) == squared.shape[1]:
        return points[np.argsort(few)]
    return extend(points, few, squared, refine=False, threads=1)


def _different(minima: list[tuple[float, NDArray[np.float32]]]) -> Iterator[NDArray[np.float32]]:
    """Yield the lowest minima, without those that count as equal."""
    last, found = -np.inf, 0
    for loss, axes in sorted(minima, key=lambda minimum: minimum[0]):
        if found < DIFFERENT and loss > last * (1.0 + _SAME):
            yield axes
            last, found = loss, found + 1


def _far_points(distances: Floats, count: int) -> Indices:
    """Return `count` points, each the farthest from all previous ones.

    The first is the point with the largest sum of squared distances, so that the order of the points does not matter.
    """
    chosen = np.empty(count, np.int64)
    nearest = np.full(len(distances), np.inf)
    point = int((distances**2).sum(axis=1).argmax())
    for number in range(count):
        chosen[number] = point
        nearest = np.minimum(nearest, distances[point])
        nearest[point] = -1.0
        point = int(nearest.argmax())
    return chosen


def _metric(weights: Floats | None, few: Indices) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the weights of pairs of the few points, and V^+ of eq. 8. For equal weights both are empty, (0, 0)."""
    empty = np.empty((0, 0), np.float32)
    if weights is None or are_equal(weights):
        return empty, empty
    pairs = weights[few][:, few]
    laplacian = np.diag(pairs.sum(axis=1)) - pairs
    if not pairs.max() > 0 or np.linalg.matrix_rank(laplacian, hermitian=True) < len(few) - 1:
        return empty, empty
    inverse = np.linalg.pinv(laplacian / pairs.max(), hermitian=True)
    return (pairs / pairs.max()).astype(np.float32), inverse.astype(np.float32)


def random_points(distances: Floats, dimensions: int, times: int, seed: int = 0) -> Iterator[Floats]:
    """Yield normally distributed points whose expected mean squared distance equals that of the given distances."""
    rng = np.random.default_rng(seed)
    spread = np.sqrt(np.mean(distances**2) / (2 * dimensions))  # E |x - y|^2 = 2 m spread^2
    for _ in range(times):
        yield spread * rng.standard_normal((len(distances), dimensions))


@kernel
def _descend(axes, distances, weights, inverse, most, enough):
    """Move points, given as `axes` (m, k), to a minimum of the stress; return the loss there.

    The steps are those of SMACOF with momentum (Nesterov 1983). The momentum restarts when the loss rises (O'Donoghue &
    Candes 2015).
    """
    dimensions, count = axes.shape
    gradients, losses = np.empty((1, dimensions, count), np.float32), np.empty((1, count), np.float32)
    ahead, before = axes.copy(), axes.copy()
    last, age, small = np.float32(np.inf), 0, 0
    for _ in range(most):
        add_blocks(ahead, distances, weights, 0, 1, gradients, losses)
        loss = losses.sum()
        rises = loss > last
        small = small + 1 if not rises and last - loss <= enough * loss else 0
        age = 0 if rises else age + 1
        last = loss
        step = gradients[0] @ inverse if len(inverse) > 0 else gradients[0] / np.float32(count)
        axes[:] = ahead - step
        if small == 2:
            break
        momentum = np.float32(max(0, age - 1) / (age + 2))
        for axis in range(dimensions):
            for j in range(count):
                ahead[axis, j] = axes[axis, j] + momentum * (axes[axis, j] - before[axis, j])
        before[:] = axes
    add_blocks(axes, distances, weights, 0, 1, gradients, losses)
    return losses.sum()
