"""Canonical pose: centred, turned to its principal axes, scaled (section 2.3)."""

from __future__ import annotations

import numpy as np

from unbend.arrays import Floats


def principal_pose(points: Floats, weights: Floats) -> Floats:
    """Centre `points` (n, m) and turn them so that their second moments are diagonal and fall.

    Each axis points to the side of its larger third moment. Where that moment is near zero the sign means
    nothing and may flip with the input; descriptors must not depend on it.

    Parameters
    ----------
    points : (n, m) float64
    weights : (n,) float64
        Not negative, of any positive sum: the area that each point stands for.

    Returns
    -------
    (n, m) float64
        The points moved by a rotation or a reflection; scale is kept.
    """
    share = weights / weights.sum()
    centred = points - share @ points
    _, axes = np.linalg.eigh((centred * share[:, None]).T @ centred)
    turned = centred @ axes[:, ::-1]
    skew = share @ turned**3
    return np.asarray(turned * np.where(skew < 0, -1.0, 1.0))
