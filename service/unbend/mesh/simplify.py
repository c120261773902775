"""Fewer vertices for a surface, and where each of its vertices went."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from importlib import import_module
from typing import Final

import numpy as np

from unbend.arrays import Floats, Indices, Ints
from unbend.errors import MeshGeometryError
from unbend.mesh.areas import triangle_areas
from unbend.mesh.boxes import morton_order
from unbend.mesh.clean import drop_repeats
from unbend.mesh.deviation import largest_distance
from unbend.mesh.report import MeshReport
from unbend.mesh.surface import Surface

_ROUNDS: Final = 10
_NUDGE: Final = 1e-9  # of the surface's extent: far below any deviation, far above rounding
_LOCK: Final = threading.Lock()  # the library keeps the mesh it works on in global variables


@dataclass(frozen=True, eq=False)
class Simplified:
    """Arrays of a simpler surface, every vertex of which is used, and how it came to be."""

    vertices: Floats  # (k, 3)
    faces: Ints  # (f, 3)
    vertex_map: Indices
    """For each vertex of the surface given its vertex here, -1 where it has none, (n,)."""
    deviation: float
    """Largest distance of a vertex of the surface given from this one."""


def simplify(surface: Surface, most: int) -> Simplified:
    """Collapse edges of `surface`, those first that bend it least, until at most `most` vertices are left.

    Quadric error metrics (Garland & Heckbert 1997) as fast-simplification does them. Collapses may part a surface
    where it hangs together by a vertex.

    Raises
    ------
    MeshGeometryError
        If the surface cannot be simplified so far.
    """
    # The library wants neighbours near in memory (several times faster than a shuffled mesh), and a surface of the
    # size its thresholds were made for, at the origin.
    used = surface.used_vertices[morton_order(surface.vertices[surface.used_vertices])]
    place = np.full(len(surface.vertices), -1)
    place[used] = np.arange(len(used))
    faces = place[surface.faces].astype(np.int32)
    points = surface.vertices[used]
    origin, scale = points[0], surface.extent
    vertices, faces, into = _collapse_to(most, (points - origin) / scale, faces[np.argsort(faces[:, 0], kind="stable")])
    vertices = _restored(vertices * scale + origin, points, into)
    vertex_map = np.full(len(surface.vertices), -1)
    vertex_map[used] = into
    deviation = largest_distance(points, vertices, faces, into)
    return Simplified(vertices, faces, vertex_map, deviation)


def _collapse_to(most: int, vertices: Floats, faces: Ints) -> tuple[Floats, Ints, Indices]:
    """Collapse in rounds, for the library counts faces and not vertices; each goes on where the last one stopped."""
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
    """Collapse edges until `target` faces are left; return what is left and where each vertex went."""
    library = import_module("fast_simplification")  # costs time and memory that only those pay who simplify
    vertices = _nudged(vertices, faces)
    with _LOCK:
        left, _, collapses = library.simplify(vertices, faces, target_count=target, return_collapses=True)
    heir = np.arange(len(vertices))
    heir[collapses[:, 1]] = collapses[:, 0]
    while (heir != heir[heir]).any():
        heir = heir[heir]
    images, _ = drop_repeats(heir[faces], len(vertices), MeshReport())
    survivors = np.unique(images)  # in the order in which the library returns them
    place = np.full(len(vertices), -1)
    place[survivors] = np.arange(len(survivors))
    return left, place[images].astype(np.int32), _adopted(place[heir], faces)


def _nudged(vertices: Floats, faces: Ints) -> Floats:
    """Give faces without an area a plane, whichever: the library computes one for each, and never touches a NaN."""
    flat = np.unique(faces[triangle_areas(vertices, faces, 1.0) == 0])
    vertices = vertices.copy()
    vertices[flat] += np.random.default_rng(0).normal(0.0, _NUDGE, (len(flat), 3))
    return vertices


def _adopted(place: Indices, faces: Ints) -> Indices:
    """Give vertices whose faces all collapsed the place of a neighbour, or of a neighbour's neighbour, and so on."""
    while True:
        corners = place[faces]
        lost = corners < 0
        rows = lost.any(axis=1) & ~lost.all(axis=1)
        if not rows.any():
            return place
        neighbour = np.broadcast_to(corners[rows].max(axis=1)[:, None], (int(rows.sum()), 3))
        np.maximum.at(place, faces[rows][lost[rows]], neighbour[lost[rows]])


def _restored(vertices: Floats, points: Floats, into: Indices) -> Floats:
    """Give vertices that stand for themselves alone, and so were not moved, their exact coordinates back."""
    has = np.flatnonzero(into >= 0)
    alone = has[np.bincount(into[has], minlength=len(vertices))[into[has]] == 1]
    vertices[into[alone]] = points[alone]
    return vertices


def through(first: Indices, second: Indices) -> Indices:
    """Follow one map after another: -1 in the first stays -1."""
    return np.where(first >= 0, second[first], -1)
