"""Canonical pose: centred points along their principal axes (section 2.3)."""

from __future__ import annotations

from typing import Final

import numpy as np

from unbend.arrays import Floats

_SYMMETRIC: Final = 1e-6
"""A third moment below this share of the mean of |x|^3 counts as rounding error of single precision coordinates."""

_AWAY: Final = 0.5
"""Least distance of a point that may determine the sign of an axis, as a share of the largest distance."""


def principal_pose(points: Floats, weights: Floats) -> Floats:
    """Centre `points` (n, m) and rotate them so that their second moments are diagonal and falling.

    Each axis points in the direction in which its third moment is positive. If the third moment is zero up to rounding,
    as on symmetric shapes, the first point far from the origin along the axis decides. That choice depends on the order
    of the points, but not on the rounding of their coordinates. If two second moments are equal, the axes in their
    plane are arbitrary. In neither case is there a continuous choice, so descriptors do not depend on the pose (see
    `moments`).

    Parameters
    ----------
    points : (n, m) float64
    weights : (n,) float64
        Area that each point represents: not negative, with a positive sum.

    Returns
    -------
    (n, m) float64
        The centred points after a rotation or a reflection. The scale is kept.
    """
    share = weights / weights.sum()
    centred = points - share @ points
    turned = in_principal_axes(centred, share)
    return np.asarray(turned * _signs(turned, share))


def in_principal_axes(centred: Floats, share: Floats) -> Floats:
    """Return centred points (n, m) in the coordinates of their principal axes, sorted by falling second moments."""
    _, axes = np.linalg.eigh((centred * share[:, None]).T @ centred)
    return np.asarray(centred @ axes[:, ::-1])


def _signs(turned: Floats, share: Floats) -> Floats:
    """Return the sign by which each axis is multiplied, 1 or -1, (m,)."""
    turned = turned / np.ldexp(1.0, np.frexp(np.abs(turned).max())[1])  # so that cubes stay in range, without rounding
    size = np.abs(turned)
    skew, whole = share @ turned**3, share @ size**3
    first = np.take_along_axis(turned, (size > _AWAY * size.max(axis=0)).argmax(axis=0)[None], axis=0)[0]
    return np.asarray(np.where(np.where(np.abs(skew) > _SYMMETRIC * whole, skew, first) < 0, -1.0, 1.0))
