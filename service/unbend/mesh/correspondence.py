"""The correspondence between the vertices of a file and of its surface, which reading may have simplified."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from unbend.arrays import Floats, Indices
from unbend.errors import UnsuitedError
from unbend.mesh.surface import Surface

T = TypeVar("T", bound=np.generic)


def surface_vertex(surface: Surface, vertex: int, what: str) -> int:
    """Return the vertex of `surface` for a vertex of the file.

    Raises
    ------
    UnsuitedError
        If the file has no such vertex, or simplification removed it. `what` names the argument in the message.
    """
    count = len(surface.vertices if surface.vertex_map is None else surface.vertex_map)
    if not 0 <= vertex < count:
        raise UnsuitedError(f"{what}: the mesh has no vertex {vertex}, only 0 to {count - 1}").with_advice(
            f"Give a vertex of the file: a number from 0 to {count - 1}."
        )
    place = vertex if surface.vertex_map is None else int(surface.vertex_map[vertex])
    if place < 0:
        raise UnsuitedError(f"{what}: vertex {vertex} was removed when the mesh was simplified").with_advice(
            "Give another vertex of the file."
        )
    return place


def at_given_vertices(surface: Surface, distances: Floats) -> Floats:
    """Return distances to the vertices of the file from distances to the vertices of `surface`, (n,).

    Vertices that simplification removed have infinite distance, like unreachable ones.
    """
    if surface.vertex_map is None:
        return distances
    return np.where(surface.vertex_map < 0, np.inf, distances[surface.vertex_map])


def at_file_vertices(surface: Surface, values: NDArray[T], missing: Any) -> NDArray[T]:
    """Return values at the vertices of the file, (k, ...), from values at the vertices of `surface`, (n, ...).

    Vertices that simplification removed have the value `missing`.
    """
    if surface.vertex_map is None:
        return values
    found = values[surface.vertex_map]
    found[surface.vertex_map < 0] = missing
    return found


def file_vertices(surface: Surface) -> Indices:
    """Return the first vertex of the file that became each vertex of `surface`, (n,); -1 where none did."""
    count = len(surface.vertices)
    if surface.vertex_map is None:
        return np.arange(count)
    kept = np.flatnonzero(surface.vertex_map >= 0)[::-1]  # the first of several is written last
    found = np.full(count, -1)
    found[surface.vertex_map[kept]] = kept
    return found
