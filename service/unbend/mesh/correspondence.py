"""Vertices of a mesh as it was given, on the surface that was read from it: reading may have simplified it."""

from __future__ import annotations

import numpy as np

from unbend.arrays import Floats
from unbend.errors import UnsuitedError
from unbend.mesh.surface import Surface


def surface_vertex(surface: Surface, vertex: int, what: str) -> int:
    """Return the vertex of `surface` that a vertex of the mesh as it was given became.

    Raises
    ------
    UnsuitedError
        If the mesh had no such vertex, or it vanished when the mesh was simplified; `what` names it in the message.
    """
    count = len(surface.vertices if surface.vertex_map is None else surface.vertex_map)
    if not 0 <= vertex < count:
        raise UnsuitedError(f"{what}: the mesh has no vertex {vertex}, only 0 to {count - 1}")
    place = vertex if surface.vertex_map is None else int(surface.vertex_map[vertex])
    if place < 0:
        raise UnsuitedError(f"{what}: vertex {vertex} vanished when the mesh was simplified")
    return place


def at_given_vertices(surface: Surface, distances: Floats) -> Floats:
    """Return distances to the vertices of `surface`, (n,), as those to the vertices of the mesh as it was given.

    Infinite for a vertex that vanished, as for one that cannot be reached.
    """
    if surface.vertex_map is None:
        return distances
    return np.where(surface.vertex_map < 0, np.inf, distances[surface.vertex_map])
