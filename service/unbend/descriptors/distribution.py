"""Shape distributions D2 (Osada et al. 2001): how distances between two random points are distributed."""

from __future__ import annotations

from typing import Final

import numpy as np

from unbend.arrays import Floats

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
    first, second = np.triu_indices(len(distances), 1)
    pair_weights = weights[first] * weights[second]
    straight = np.sqrt(((points[first] - points[second]) ** 2).sum(axis=1))
    both = [_quantiles(values, pair_weights) for values in (distances[first, second], straight)]
    return np.concatenate(both) / len(_LEVELS)


def _quantiles(values: Floats, weights: Floats) -> Floats:
    order = np.argsort(values)
    cumulative = np.cumsum(weights[order])
    return np.interp(_LEVELS, (cumulative - 0.5 * weights[order]) / cumulative[-1], values[order])
