"""Shape distributions D2 (Osada et al. 2001): how distances between two random points are distributed."""

from __future__ import annotations

from typing import Final

import numpy as np

from unbend.arrays import Floats
from unbend.jit import kernel

_LEVELS: Final = (np.arange(64) + 0.5) / 64


def distance_distribution(distances: Floats, points: Floats, weights: Floats) -> Floats:
    """Return quantiles of the distances between two points chosen at random by area.

    Quantiles, unlike a histogram's bins, have no edges that a small change could carry a value across; L1 between
    them is the earth mover's distance between the distributions.

    Parameters
    ----------
    distances : (k, k) float64
        Geodesic distances over the square root of the surface's area.
    points : (k, m) float64
        The signature in the same unit.
    weights : (k,) float64
        Share of the area that each sample stands for.

    Returns
    -------
    (128,) float64
        64 quantiles of the geodesic distances, then 64 of the straight ones in the signature, each over 64, so
        that the L1 distance is a mean.
    """
    count = len(distances)
    geodesic, straight, shares = np.empty((3, count * (count - 1) // 2))
    _fill_pairs(distances, points, weights, geodesic, straight, shares)
    return np.concatenate([_quantiles(values, shares) for values in (geodesic, straight)]) / len(_LEVELS)


@kernel
def _fill_pairs(distances, points, weights, geodesic, straight, shares):
    """Fill, for each pair of samples, their geodesic and straight distances and the product of their weights."""
    pair = 0
    for i in range(len(distances)):
        for j in range(i + 1, len(distances)):
            squared = 0.0
            for axis in range(points.shape[1]):
                squared += (points[i, axis] - points[j, axis]) ** 2
            geodesic[pair], straight[pair], shares[pair] = distances[i, j], np.sqrt(squared), weights[i] * weights[j]
            pair += 1


def _quantiles(values: Floats, weights: Floats) -> Floats:
    order = np.argsort(values)
    sorted_weights = weights[order]
    cumulative = np.cumsum(sorted_weights)
    return np.interp(_LEVELS, (cumulative - 0.5 * sorted_weights) / cumulative[-1], values[order])
