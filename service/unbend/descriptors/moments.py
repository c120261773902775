"""Second and third order moments of a posed point set (Tal & Elad, cited in section 2.3)."""

from __future__ import annotations

from itertools import combinations_with_replacement

import numpy as np

from unbend.arrays import Floats

_AXES = 3  # moments over more axes would be more than the paper's 15


def moments(posed: Floats, weights: Floats) -> Floats:
    """Return the moments of a point set in its principal pose.

    Second order: the mean of x_i^2 along each axis (the mixed ones vanish in this pose). Third order: the
    absolute mean of x_i x_j x_k for i <= j <= k. An axis' sign is arbitrary on symmetric shapes; the absolute
    value is the same for either and does not jump between them.

    Parameters
    ----------
    posed : (n, m) float64
        As `principal_pose` returns; the first three axes are used.
    weights : (n,) float64
        Area that each point stands for.

    Returns
    -------
    (13,) float64 for m >= 3, (6,) for m = 2, (2,) for m = 1.
    """
    share = weights / weights.sum()
    axes = posed[:, :_AXES].T
    second = (axes**2) @ share
    third = [(axes[i] * axes[j] * axes[k]) @ share for i, j, k in combinations_with_replacement(range(len(axes)), 3)]
    return np.concatenate([second, np.abs(third)])
