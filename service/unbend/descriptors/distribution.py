"""Shape distributions D2 (Osada et al. 2001): the distribution of distances between two random points."""

from __future__ import annotations

from typing import Final

import numpy as np

from unbend.arrays import Floats
from unbend.jit import kernel

_LEVELS: Final = (np.arange(64) + 0.5) / 64


def distance_distribution(distances: Floats, points: Floats, weights: Floats) -> Floats:
    """Return quantiles of the distances between two points that are chosen at random by area.

    Quantiles change continuously, while a histogram jumps when a value crosses the edge of a bin. The L1 distance
    between quantiles is the earth mover's distance between the distributions.

    Parameters
    ----------
    distances : (k, k) float64
        Geodesic distances over the square root of the surface's area.
    points : (k, m) float64
        The signature in the same unit.
    weights : (k,) float64
        Share of the area that each sample represents.

    Returns
    -------
    (128,) float64
        64 quantiles of the geodesic distances, then 64 of the Euclidean distances in the signature, each divided
        by 64, so that the L1 distance is a mean.
    """
    count = len(distances)
    geodesic, straight, shares = np.empty((3, count * (count - 1) // 2))
    _fill_pairs(distances, points, weights, geodesic, straight, shares)
    return np.concatenate([_quantiles(values, shares) for values in (geodesic, straight)]) / len(_LEVELS)


@kernel
def _fill_pairs(distances, points, weights, geodesic, straight, shares):
    """Write the geodesic distance, the Euclidean distance and the product of weights of each pair of samples."""
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
