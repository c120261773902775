"""Out-of-sample extension: placing further vertices by their distances to points that are embedded already.

Classical scaling places a further vertex by a map that is affine in its squared distances to the samples (landmark
MDS: de Silva & Tenenbaum 2004; the Nystrom method). So does FastMap, whose cosine law is affine in the squared
distances to its pivots. Therefore regression finds an affine map, in the same way for every method. For points embedded
by least squares, each vertex then moves to where its part of eq. 2 is lowest.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from unbend.arrays import Floats, Indices
from unbend.jit import kernel
from unbend.threads import share_out

_RIDGE: Final = 1e-6
"""Regularisation: share of the landmarks' variance added in all directions, so that slopes do not fit errors."""

_STEPS: Final = 8
"""Majorisation steps per vertex. The error of the affine map is a few hundredths, and each step about halves it."""

_RELAXATION: Final = 1.5
"""Over-relaxation of a majorisation step. Below 2 the stress still falls (de Leeuw & Heiser 1980), and faster."""


def extend(
    points: Floats, samples: Indices, squared: NDArray[np.float32], *, refine: bool, threads: int | None = None
) -> Floats:
    """Place every vertex by its distances to landmarks, a prefix of the samples.

    Parameters
    ----------
    points : (k, m) float64
        The samples' points.
    samples : (k,) int64
        Vertex of each sample.
    squared : (l, n) float32
        Squared distances from the first l samples to all n vertices, in the unit of `points`.
    refine : bool
        Whether to lower the stress of eq. 2 afterwards, as is right for points embedded by least squares.
    threads : int, optional
        All cores by default. The result does not depend on it.

    Returns
    -------
    (n, m) float64
        Close to `points` at the samples, but not equal. NaN at vertices that a landmark does not reach.
    """
    slopes, constant = _affine_map(points, squared[:, samples].astype(np.float64))
    landmarks = np.ascontiguousarray(points[: len(squared)].T)
    result = np.empty((squared.shape[1], points.shape[1]))

    def place(part: slice) -> None:
        _place_affine(squared, slopes, constant, part.start, part.stop, result)
        if refine:
            _lower_stress(squared, landmarks, part.start, part.stop, result)

    share_out(len(result), threads, place)
    return result


def _affine_map(points: Floats, squared: Floats) -> tuple[Floats, Floats]:
    """Return slopes (m, l) and the constant (m,) that fit `squared` (l, k) to `points` (k, m)."""
    means, centre = squared.mean(axis=1), points.mean(axis=0)
    given = squared - means[:, None]
    normal = given @ given.T
    normal[np.diag_indices(len(normal))] += _RIDGE * np.trace(normal) or 1.0  # 1.0: all points coincide, no slope
    slopes = np.linalg.solve(normal, given @ (points - centre)).T
    return np.ascontiguousarray(slopes), centre - slopes @ means


@kernel
def _place_affine(squared, slopes, constant, start, stop, points):
    """Write `points[start:stop]` as slopes times squared distances plus the constant, NaN for infinite distances."""
    dimensions, count = slopes.shape
    for v in range(start, stop):
        here = points[v]
        here[:] = constant
        for j in range(count):
            given = np.float64(squared[j, v])
            if not np.isfinite(given):
                here[:] = np.nan
                break
            for axis in range(dimensions):
                here[axis] += slopes[axis, j] * given


@kernel
def _lower_stress(squared, landmarks, start, stop, points):
    """Move each of `points[start:stop]` so that its distances to `landmarks` (m, l) approach those given.

    Each landmark has a preferred place for the vertex: at the given distance, in the vertex' current direction. A step
    moves the vertex towards the mean of these places. That lowers sum_j (delta_vj - |x_v - x_j|)^2, which is the part
    of eq. 2 that depends on this vertex.
    """
    dimensions, count = landmarks.shape
    given, ratio = np.empty(count), np.empty(count)
    for v in range(start, stop):
        here = points[v]
        for j in range(count):
            given[j] = np.sqrt(squared[j, v])
        for _ in range(_STEPS):
            ratio[:] = 0.0
            for axis in range(dimensions):
                for j in range(count):
                    ratio[j] += (here[axis] - landmarks[axis, j]) ** 2
            for j in range(count):
                ratio[j] = given[j] / np.sqrt(ratio[j]) - 1.0 if ratio[j] > 0.0 else 0.0
            for axis in range(dimensions):
                step = 0.0
                for j in range(count):
                    step += ratio[j] * (here[axis] - landmarks[axis, j])
                here[axis] += _RELAXATION * step / count
