"""Canonical pose: centred, turned to its principal axes, scaled (section 2.3)."""

from __future__ import annotations

from typing import Final

import numpy as np

from unbend.arrays import Floats

_SYMMETRIC: Final = 1e-6
"""Share of the mean of |x|^3 below which a third moment is rounding, of coordinates known to single precision."""

_AWAY: Final = 0.5
"""Share of the farthest point's distance from which on a point is away from the origin of an axis."""


def principal_pose(points: Floats, weights: Floats) -> Floats:
    """Centre `points` (n, m) and turn them so that their second moments are diagonal and fall.

    Each axis points to the side of its larger third moment. Where that is zero but for rounding, as on symmetric
    shapes, either side would do, and the first point away from the axis' origin decides: it depends on the order of
    the points, but not on how their coordinates round. Where two second moments are equal the axes are any in their
    plane. No continuous choice exists in either case, so descriptors do not use the pose (`moments`).

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
    return np.asarray(turned * _signs(turned, share))


def _signs(turned: Floats, share: Floats) -> Floats:
    """Return 1 or -1 for each axis, (m,)."""
    size = np.abs(turned)
    skew, whole = share @ turned**3, share @ size**3
    first = np.take_along_axis(turned, (size > _AWAY * size.max(axis=0)).argmax(axis=0)[None], axis=0)[0]
    return np.asarray(np.where(np.where(np.abs(skew) > _SYMMETRIC * whole, skew, first) < 0, -1.0, 1.0))
