"""Key points: extrema of the Gaussian curvature at a scale (section 5: "extremum points of the Gaussian curvature")."""

from __future__ import annotations

from typing import Final

import numpy as np

from unbend.arrays import Floats, Indices
from unbend.errors import ParameterError
from unbend.local.signatures import LocalSignatures

SCALE: Final = 0.15
"""Radius of the circles that measure curvature, over the square root of the area."""


def curvature(local: LocalSignatures, scale: float = SCALE) -> Floats:
    """Return the Gaussian curvature at each centre, at a scale, (c,), in 1 over squared units of the vertices.

    A small circle of radius r around a point of curvature K has the area pi r^2 - pi K r^4 / 12 (Bertrand, Diguet and
    Puiseux 1848). The mean over a circle does not depend on the triangulation, as angles at vertices do. The
    boundary cuts area from circles that touch it, so they do not tell the curvature: NaN.
    """
    rung = int(np.abs(np.log(local.radii / (scale * np.sqrt(local.area)))).argmin())
    radius = local.radii[rung]
    values = 12 * (np.pi - local.growth[:, rung].astype(np.float64)) / (np.pi * radius**2)
    return np.asarray(np.where(local.reach >= radius, values, np.nan))


def key_points(local: LocalSignatures, count: int = 5, *, scale: float = SCALE) -> Indices:
    """Return the centres where the curvature is extreme among all centres nearer than the scale.

    Parameters
    ----------
    local : LocalSignatures
    count : int, default 5
        Most key points.
    scale : float, default 0.15
        Radius over the square root of the area, at which curvature is measured and extrema are sought.

    Returns
    -------
    (k,) int64
        Indices of centres, those of the largest absolute curvature first; none where no circle fits.

    Raises
    ------
    ParameterError
        If `count` is below 1 or `scale` is not positive.
    """
    if count < 1 or not scale > 0:
        raise ParameterError(f"count must be at least 1 and scale positive, not {count} and {scale}")
    values = curvature(local, scale)
    near = local.distances < scale * np.sqrt(local.area)
    around = np.where(near & np.isfinite(values), values, np.nan)
    valid = np.flatnonzero(np.isfinite(values))
    highest, lowest = np.nanmax(around[valid], axis=1), np.nanmin(around[valid], axis=1)
    extreme = valid[(values[valid] == highest) | (values[valid] == lowest)]
    return np.asarray(extreme[np.argsort(-np.abs(values[extreme]), kind="stable")][:count])
