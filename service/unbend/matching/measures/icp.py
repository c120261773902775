"""Kernels of the iterative closest point method (Besl & McKay 1992), symmetric and with reflections.

A motion x -> R x + t is an array (m, m + 1). R is orthogonal and may be a reflection. t is the last column.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from unbend.jit import kernel

MIN_AXES: Final = 3
"""Least number of coordinates of points. Callers pad with zeros."""

_TOLERANCE: Final = 1e-3
"""Iterations stop when a step lowers the cost by less than this share of it."""


@kernel
def refine(motions, steps, a, rows_a, weights_a, b, rows_b, weights_b):
    """Improve each of `motions` (n, m, m + 1) of form `a` onto form `b`, in place, and return their costs, (n,).

    The cost is the weighted mean squared distance from points to the nearest point of the other form, summed over both
    directions. A step pairs nearest points in both directions, then finds the motion of least cost for these pairs.
    Neither half of a step raises the cost. The last of `steps` only pairs points, so a single step returns the cost of
    the unchanged motion.

    Forms are (k, m), centred. The indices `rows_a` and `rows_b` choose the points that are paired with their nearest
    point. `weights_a` and `weights_b`, which sum to 1, are the weights of these points.
    """
    single_a, single_b = _axis_by_axis(a), _axis_by_axis(b)
    costs = np.empty(len(motions))
    for i in range(len(motions)):
        costs[i] = _icp(motions[i], steps, a, single_a, rows_a, weights_a, b, single_b, rows_b, weights_b)
    return costs


@kernel
def residuals(motion, a, b):
    """Return the distance from each moved point of `a` to the nearest of `b`, (k_a,), and the reverse, (k_b,)."""
    return _distances(motion, a, b), _distances(_inverse(motion), b, a)


@kernel
def farthest_points(points, start, count):
    """Sample `count` points: `start`, then repeatedly the point that is farthest from all previous ones.

    Return the indices of the samples, (count,), and for each point the number of its nearest sample, (k,).
    """
    chosen, nearest = np.zeros(count, np.int32), np.zeros(len(points), np.int32)
    least = np.full(len(points), np.inf)
    farthest = start
    for place in range(count):
        chosen[place], farthest = farthest, 0
        for i in range(len(points)):
            squared = 0.0
            for axis in range(points.shape[1]):
                squared += (points[i, axis] - points[chosen[place], axis]) ** 2
            if squared < least[i]:
                least[i], nearest[i] = squared, place
            if least[i] > least[farthest]:
                farthest = i
    return chosen, nearest


@kernel
def _icp(motion, steps, a, single_a, rows_a, weights_a, b, single_b, rows_b, weights_b):
    before = np.inf
    for step in range(steps):
        to_b = _nearest(_moved(motion, a, rows_a), single_b)
        to_a = _nearest(_moved(_inverse(motion), b, rows_b), single_a)
        sums = np.zeros((a.shape[1] + 1, a.shape[1] + 1))
        cost = _add_pairs(sums, motion, a, rows_a, b, to_b, weights_a)
        cost += _add_pairs(sums, motion, a, to_a, b, rows_b, weights_b)
        if step == steps - 1 or cost == 0.0 or cost >= (1.0 - _TOLERANCE) * before:
            return cost
        before = cost
        _fit_motion(motion, sums)
    return before


@kernel
def _axis_by_axis(points):
    """Return the points (k, m) as (m, k) in single precision, which is enough to find nearest points."""
    turned = np.empty((points.shape[1], points.shape[0]), np.float32)
    for i in range(points.shape[0]):
        for axis in range(points.shape[1]):
            turned[axis, i] = points[i, axis]
    return turned


@kernel
def _moved(motion, points, rows):
    """Return R x + t for the `rows` (n,) of the points (k, m), as (m, n), in single precision."""
    axes = points.shape[1]
    moved = np.empty((axes, len(rows)), np.float32)
    for i in range(len(rows)):
        for row in range(axes):
            value = motion[row, axes]
            for axis in range(axes):
                value += motion[row, axis] * points[rows[i], axis]
            moved[row, i] = value
    return moved


@kernel
def _inverse(motion):
    """Return y -> R^T (y - t)."""
    axes = len(motion)
    inverse = np.empty_like(motion)
    for row in range(axes):
        shift = 0.0
        for axis in range(axes):
            inverse[row, axis] = motion[axis, row]
            shift -= motion[axis, row] * motion[axis, axes]
        inverse[row, axes] = shift
    return inverse


@kernel
def _nearest(queries, points):
    """Return the index of the nearest of `points` (m, k) for each of `queries` (m, n), the first one of ties.

    The outer loop runs over points, so that the inner loops over queries compile to vector instructions. For some
    hundred points this is faster than a search tree. One loop handles the first three coordinates together, because
    most forms have no others.
    """
    count = queries.shape[1]
    x, y, z = queries[0], queries[1], queries[2]
    found, least = np.zeros(count, np.int32), np.full(count, np.inf, np.float32)
    further = np.zeros(count, np.float32)
    for point in range(points.shape[1]):
        if len(points) > MIN_AXES:
            further[:] = 0
        for axis in range(MIN_AXES, len(points)):
            row, place = queries[axis], points[axis, point]
            for i in range(count):
                further[i] += (row[i] - place) * (row[i] - place)
        px, py, pz = points[0, point], points[1, point], points[2, point]
        for i in range(count):
            squared = (x[i] - px) * (x[i] - px) + (y[i] - py) * (y[i] - py) + (z[i] - pz) * (z[i] - pz) + further[i]
            nearer = squared < least[i]
            least[i] = squared if nearer else least[i]
            found[i] = point if nearer else found[i]
    return found


@kernel
def _distances(motion, points, others):
    """Return the distances from the moved `points` to the nearest of `others`, found in single precision, (k,)."""
    axes = points.shape[1]
    found = _nearest(_moved(motion, points, np.arange(len(points))), _axis_by_axis(others))
    distances = np.empty(len(points))
    for i in range(len(points)):
        squared = 0.0
        for row in range(axes):
            value = motion[row, axes] - others[found[i], row]
            for axis in range(axes):
                value += motion[row, axis] * points[i, axis]
            squared += value * value
        distances[i] = np.sqrt(squared)
    return distances


@kernel
def _add_pairs(sums, motion, a, rows_a, b, rows_b, weights):
    """Add w [y; 1] [x; 1]^T of pairs (x of `a`, y of `b`) to `sums`; return the sum of w |R x + t - y|^2."""
    axes = a.shape[1]
    cost = 0.0
    for pair in range(len(weights)):
        weight, i, j = weights[pair], rows_a[pair], rows_b[pair]
        for row in range(axes):
            y = b[j, row]
            miss = motion[row, axes] - y
            for axis in range(axes):
                miss += motion[row, axis] * a[i, axis]
                sums[row, axis] += weight * y * a[i, axis]
            sums[row, axes] += weight * y
            sums[axes, row] += weight * a[i, row]
            cost += weight * miss * miss
        sums[axes, axes] += weight
    return cost


@kernel
def _fit_motion(motion, sums):
    """Set `motion` to the least squares motion of the pairs summed in `sums` (Kabsch 1976; Umeyama 1991).

    If H = U S V^T is the covariance of y and x, then R = U V^T maximises tr(R^T H) over all orthogonal matrices. The
    sign of its determinant is not checked, because reflections are allowed.
    """
    axes = len(motion)
    total = sums[axes, axes]
    covariance = np.empty((axes, axes))
    for row in range(axes):
        for axis in range(axes):
            covariance[row, axis] = sums[row, axis] - sums[row, axes] * sums[axes, axis] / total
    left, _, right = np.linalg.svd(covariance)
    for row in range(axes):
        shift = sums[row, axes] / total
        for axis in range(axes):
            value = 0.0
            for z in range(axes):
                value += left[row, z] * right[z, axis]
            motion[row, axis] = value
            shift -= value * sums[axes, axis] / total
        motion[row, axes] = shift
