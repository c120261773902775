"""The correspondence between the vertices of a file and of its surface, which reading may have simplified."""

from __future__ import annotations

import numpy as np

from unbend.arrays import Floats
from unbend.errors import UnsuitedError
from unbend.mesh.surface import Surface


def surface_vertex(surface: Surface, vertex: int, what: str) -> int:
    """Return the vertex of `surface` for a vertex of the file.

    Raises
    ------
    UnsuitedError
        If the file has no such vertex, or simplification removed it. `what` names the argument in the message.
    """
    count = len(surface.vertices if surface.vertex_map is None else surface.vertex_map)
    if not 0 <= vertex < count:
        raise UnsuitedError(f"{what}: the mesh has no vertex {vertex}, only 0 to {count - 1}")
    place = vertex if surface.vertex_map is None else int(surface.vertex_map[vertex])
    if place < 0:
        raise UnsuitedError(f"{what}: vertex {vertex} was removed when the mesh was simplified")
    return place


def at_given_vertices(surface: Surface, distances: Floats) -> Floats:
    """Return distances to the vertices of the file from distances to the vertices of `surface`, (n,).

    Vertices that simplification removed have infinite distance, like unreachable ones.
    """
    if surface.vertex_map is None:
        return distances
    return np.where(surface.vertex_map < 0, np.inf, distances[surface.vertex_map])
