"""Simplification of a surface, with a map of its vertices."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from importlib import import_module
from typing import Final

import numpy as np

from unbend.arrays import Floats, Indices, Ints, positions_of
from unbend.errors import MeshGeometryError
from unbend.mesh.areas import triangle_areas
from unbend.mesh.boxes import morton_order
from unbend.mesh.clean import drop_repeats
from unbend.mesh.deviation import largest_distance
from unbend.mesh.report import MeshReport
from unbend.mesh.surface import Surface

_ROUNDS: Final = 10
_NUDGE: Final = 1e-9  # share of the extent: far below any deviation, far above rounding
_LOCK: Final = threading.Lock()  # fast_simplification stores its mesh in global variables


@dataclass(frozen=True, eq=False)
class Simplified:
    """A simplified surface without unused vertices, and its relation to the original surface."""

    vertices: Floats  # (k, 3)
    faces: Ints  # (f, 3)
    vertex_map: Indices
    """The new vertex of each original vertex, -1 for none, (n,)."""
    deviation: float
    """Largest distance of an original vertex from the new surface."""


def simplify(surface: Surface, most: int) -> Simplified:
    """Collapse the edges of `surface` that change it least, until at most `most` vertices are left.

    The package fast-simplification chooses edges by quadric error metrics (Garland & Heckbert 1997). Collapses may
    separate parts that only a vertex connects.

    Raises
    ------
    MeshGeometryError
        If the surface cannot be simplified that far.
    """
    # The library is several times as fast if neighbours are near in memory. Its thresholds assume a surface of extent
    # about 1 at the origin.
    used = surface.used_vertices[morton_order(surface.vertices[surface.used_vertices])]
    faces = positions_of(used, len(surface.vertices))[surface.faces].astype(np.int32)
    points = surface.vertices[used]
    origin, scale = points[0], surface.extent
    vertices, faces, into = _collapse_to(most, (points - origin) / scale, faces[np.argsort(faces[:, 0], kind="stable")])
    vertices = _restored(vertices * scale + origin, points, into)
    vertex_map = np.full(len(surface.vertices), -1)
    vertex_map[used] = into
    deviation = largest_distance(points, vertices, faces, into)
    return Simplified(vertices, faces, vertex_map, deviation)


def _collapse_to(most: int, vertices: Floats, faces: Ints) -> tuple[Floats, Ints, Indices]:
    """Collapse in rounds, because the library takes a target number of faces, not of vertices."""
    into = np.arange(len(vertices))
    before = len(vertices) + 1
    for _ in range(_ROUNDS):
        if not most < len(vertices) < before:
            break
        before = len(vertices)
        target = min(len(faces) * most // before, len(faces) - 1)
        vertices, faces, step = _collapse(vertices, faces, target)
        into = through(into, step)
    if not 0 < len(vertices) <= most:
        raise MeshGeometryError(
            f"the mesh cannot be simplified to {most:,} vertices: "
            + (f"{len(vertices):,} are left that no collapse removes" if len(vertices) else "no face would be left")
        )
    return vertices, faces, into


def _collapse(vertices: Floats, faces: Ints, target: int) -> tuple[Floats, Ints, Indices]:
    """Collapse edges until `target` faces are left; return the mesh and the new vertex of each vertex."""
    library = import_module("fast_simplification")  # imported only when needed, because it costs time and memory
    vertices = _nudged(vertices, faces)
    with _LOCK:
        left, _, collapses = library.simplify(vertices, faces, target_count=target, return_collapses=True)
    onto = np.arange(len(vertices))
    onto[collapses[:, 1]] = collapses[:, 0]
    while (onto != onto[onto]).any():
        onto = onto[onto]
    images, _ = drop_repeats(onto[faces], len(vertices), MeshReport())
    survivors = np.unique(images)  # the library returns them in this order
    place = positions_of(survivors, len(vertices))
    return left, place[images].astype(np.int32), _with_lost_vertices(place[onto], faces)


def _nudged(vertices: Floats, faces: Ints) -> Floats:
    """Move the corners of faces of zero area at random, because the library needs the plane of each face."""
    flat = np.unique(faces[triangle_areas(vertices, faces, 1.0) == 0])
    vertices = vertices.copy()
    vertices[flat] += np.random.default_rng(0).normal(0.0, _NUDGE, (len(flat), 3))
    return vertices


def _with_lost_vertices(place: Indices, faces: Ints) -> Indices:
    """Map each vertex whose faces all collapsed to the new vertex of a neighbour, ring by ring."""
    while True:
        corners = place[faces]
        lost = corners < 0
        rows = lost.any(axis=1) & ~lost.all(axis=1)
        if not rows.any():
            return place
        neighbour = np.broadcast_to(corners[rows].max(axis=1)[:, None], (int(rows.sum()), 3))
        np.maximum.at(place, faces[rows][lost[rows]], neighbour[lost[rows]])


def _restored(vertices: Floats, points: Floats, into: Indices) -> Floats:
    """Restore the exact coordinates of vertices that were not merged and therefore did not move."""
    has = np.flatnonzero(into >= 0)
    alone = has[np.bincount(into[has], minlength=len(vertices))[into[has]] == 1]
    vertices[into[alone]] = points[alone]
    return vertices


def through(first: Indices, second: Indices) -> Indices:
    """Compose two vertex maps; -1 in the first map stays -1."""
    return np.where(first >= 0, second[first], -1)
