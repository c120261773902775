"""The stress of eq. 2."""

from __future__ import annotations

import numpy as np

from unbend.arrays import Floats
from unbend.jit import kernel


def stress(points: Floats, distances: Floats, weights: Floats | None = None) -> float:
    """Stress of `points` (n, m) against `distances` (n, n), eq. 2: 0 for a perfect embedding.

    The stress is sum_{i<j} w_ij (delta_ij - d_ij)^2 / sum_{i<j} delta_ij^2, where delta are the given `distances`, d
    the distances between the `points`, and w the weights, 1 by default. If all given distances are zero, it is 0.
    """
    total = float(np.einsum("ij,ij", distances, distances)) / 2  # without a temporary matrix
    raw = raw_stress(points, distances, weights if weights is not None else np.empty((0, 0)))
    return raw / total if total > 0 else 0.0


@kernel
def raw_stress(points, distances, weights):
    """Return the numerator of eq. 2 (eq. 7); empty `weights` (0, 0) mean ones."""
    count, dimensions = points.shape
    weighted = weights.shape[0] > 0
    axes, terms, losses = np.ascontiguousarray(points.T), np.empty(count), np.zeros(count)
    for i in range(count):
        # Loops over j without reductions are vectorised and round in a fixed order.
        terms[:i] = 0.0
        for axis in range(dimensions):
            here = axes[axis, i]
            for j in range(i):
                terms[j] += (axes[axis, j] - here) ** 2
        for j in range(i):
            difference = distances[i, j] - np.sqrt(terms[j])
            terms[j] = difference * difference
        if weighted:
            for j in range(i):
                terms[j] *= weights[i, j]
        for j in range(i):
            losses[j] += terms[j]
    return losses.sum()
