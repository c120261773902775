"""Finer triangulations of coarse surfaces."""

from __future__ import annotations

from typing import Final

from unbend.mesh.subdivide import subdivided
from unbend.mesh.surface import Surface

ENOUGH: Final = 3500
"""Vertices from which distances within small circles are accurate enough. A mesh of 252 vertices is divided twice."""


def refined(surface: Surface) -> Surface:
    """Divide all triangles into four until there are `ENOUGH` vertices; the surface stays the same set of points.

    Vertices keep their numbers; those without a face do not count.
    """
    while len(surface.used_vertices) < ENOUGH:
        surface = Surface(*subdivided(surface.vertices, surface.faces))
    return surface
