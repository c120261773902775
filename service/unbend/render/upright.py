"""The upright axis of a surface, which most files do not tell."""

from __future__ import annotations

from typing import Final, Literal

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from unbend.arrays import Floats
from unbend.mesh.surface import Surface

_GROUND: Final = 0.04  # share of the height within which a surface touches the ground


def upright_axis(surface: Surface) -> Literal["y", "z"]:
    """Return the axis that points upwards: y or z, the two that programs use.

    It is the one on which the surface stands taller on a broader base: the product of two numbers is larger. The first
    is the height. The second is the base, the convex hull of what lies in the lowest 4 % of the height, as a share of
    the convex hull of the whole, both seen from above. y if the products are equal.

    Examples
    --------
    >>> from unbend.mesh.shapes import figure
    >>> upright_axis(figure("quadruped", 1))
    'z'
    """
    points = surface.vertices[surface.used_vertices]
    points = (points - points.min(axis=0)) / (surface.extent or 1.0)
    return "y" if _standing(points, 1) >= _standing(points, 2) else "z"


def _standing(points: Floats, axis: int) -> float:
    heights = points[:, axis]
    from_above = np.delete(points, axis, axis=1)
    tall = float(heights.max())
    whole = _hull_area(from_above)
    return tall * _hull_area(from_above[heights <= _GROUND * tall]) / whole if whole > 0 else 0.0


def _hull_area(points: Floats) -> float:
    """Return the area of the convex hull of points in the plane; 0 if they lie on a line."""
    if len(points) < 3:
        return 0.0
    try:
        return float(ConvexHull(points).volume)  # in the plane, this is the area
    except QhullError:
        return 0.0
