"""Kernels of the iterative closest point method (Besl & McKay 1992), both ways at once and with reflections.

A motion x -> R x + t is an array (m, m + 1): R, orthogonal, of either handedness, and t in the last column.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from unbend.jit import kernel

LEAST_AXES: Final = 3
"""The fewest coordinates that points may have here."""

_DECREASE: Final = 1e-3
"""The search stops when a step lowers the cost by less than this share of it."""


@kernel
def refine(motions, steps, a, some_a, shares_a, b, some_b, shares_b):
    """Improve each of `motions` (n, m, m + 1) of form `a` onto form `b`, in place, and return their costs, (n,).

    A step pairs nearest points both ways, then moves all pairs at once as near as they come; neither half raises the
    cost: the weighted mean squared distance from points to the nearest of the other form, summed over both
    directions. The last of `steps` only pairs, so a single one tells the cost of the motion as it is.

    Forms are (k, m), centred. Which of their points look for a partner, and with which weights, of sum 1, say the
    indices `some_a`, `some_b` (n,) and `shares_a`, `shares_b` (n,).
    """
    single_a, single_b = _axis_by_axis(a), _axis_by_axis(b)
    costs = np.empty(len(motions))
    for i in range(len(motions)):
        costs[i] = _icp(motions[i], steps, a, single_a, some_a, shares_a, b, single_b, some_b, shares_b)
    return costs


@kernel
def residuals(motion, a, b):
    """Return how far each point of `a`, moved, is from the nearest of `b`, (k_a,), and the other way round, (k_b,)."""
    return _distances(motion, a, b), _distances(_inverse(motion), b, a)


@kernel
def spread_out(points, start, count):
    """Return `count` points, from `start` on each the farthest from those before, (count,).

    With it, (k,), which of them is nearest to each point. The nearest is told by its place among those returned.
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
def _icp(motion, steps, a, single_a, some_a, shares_a, b, single_b, some_b, shares_b):
    before = np.inf
    for step in range(steps):
        to_b = _nearest(_moved(motion, a, some_a), single_b)
        to_a = _nearest(_moved(_inverse(motion), b, some_b), single_a)
        sums = np.zeros((a.shape[1] + 1, a.shape[1] + 1))
        cost = _add_pairs(sums, motion, a, some_a, b, to_b, shares_a)
        cost += _add_pairs(sums, motion, a, to_a, b, some_b, shares_b)
        if step == steps - 1 or cost == 0.0 or cost >= (1.0 - _DECREASE) * before:
            return cost
        before = cost
        _move_onto(motion, sums)
    return before


@kernel
def _axis_by_axis(points):
    """Return the points (k, m) as (m, k), in single precision: all that finding the nearest needs."""
    turned = np.empty((points.shape[1], points.shape[0]), np.float32)
    for i in range(points.shape[0]):
        for axis in range(points.shape[1]):
            turned[axis, i] = points[i, axis]
    return turned


@kernel
def _moved(motion, points, some):
    """Return R x + t of `some` (n,) of the points (k, m), as (m, n), in single precision."""
    axes = points.shape[1]
    moved = np.empty((axes, len(some)), np.float32)
    for i in range(len(some)):
        for row in range(axes):
            value = motion[row, axes]
            for axis in range(axes):
                value += motion[row, axis] * points[some[i], axis]
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
    """Return the nearest of `points` (m, k) to each of `queries` (m, n); of equally near ones the first.

    One point after the other is held against all queries: the inner loops are vector instructions, and for some
    hundred points that is faster than a search tree. The first three coordinates, mostly all, are taken at once.
    """
    count = queries.shape[1]
    x, y, z = queries[0], queries[1], queries[2]
    found, least = np.zeros(count, np.int32), np.full(count, np.inf, np.float32)
    further = np.zeros(count, np.float32)
    for point in range(points.shape[1]):
        if len(points) > LEAST_AXES:
            further[:] = 0
        for axis in range(LEAST_AXES, len(points)):
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
    """Return how far `points`, moved, are from the nearest of `others`, which is found in single precision, (k,)."""
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
def _add_pairs(sums, motion, a, some_a, b, some_b, weights):
    """Add w [y; 1] [x; 1]^T of pairs (x of `a`, y of `b`) to `sums`; return the sum of w |R x + t - y|^2."""
    axes = a.shape[1]
    cost = 0.0
    for pair in range(len(weights)):
        weight, i, j = weights[pair], some_a[pair], some_b[pair]
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
def _move_onto(motion, sums):
    """Make `motion` the one that brings the pairs behind `sums` nearest (Kabsch 1976; Umeyama 1991).

    With H = U S V^T the covariance of y and x, R = U V^T maximises tr(R^T H) over all orthogonal matrices. No look
    at its determinant: reflections are allowed.
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
