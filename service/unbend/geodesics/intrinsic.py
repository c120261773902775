"""The triangles that fronts march over: of the same surface as the given ones, but rounder.

On stretched triangles marching is wrong by as much as the distances themselves. An intrinsic triangulation of the same
surface has the same distances and better triangles: flips make it Delaunay, Steiner points mend what flips cannot
(Sharp, Soliman & Crane 2019, "Navigating intrinsic triangulations").
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from unbend.arrays import Bools, Floats, Ints
from unbend.geodesics.flips import flip_to_delaunay, mollified
from unbend.geodesics.halfedges import HalfEdges
from unbend.geodesics.refinement import largest_cosine, refine
from unbend.jit import kernel
from unbend.tolerances import MOST_STEINER, NARROW, ROUND_ANGLE, STEINER_FLOOR, STRETCHED_SHARE, THIN_ANGLE


@dataclass(frozen=True, eq=False)
class Intrinsic:
    """An intrinsic triangulation."""

    half_edges: HalfEdges
    changed: Bools  # (m,) faces that are not, corner by corner, among the given ones
    given_changed: Bools  # (m0,) the same of the given faces: they are no more


def intrinsic_triangulation(given: HalfEdges) -> Intrinsic:
    """Return the triangulation that marching runs on; the given one, uncopied, where that is as good.

    Vertices keep their numbers, Steiner points follow them. The worst corners are always refined; where many are thin
    even after all flips, as on CAD models and steep height maps, every corner is.
    """
    count = len(given.faces)
    lengths = mollified(given.lengths)
    mesh = (given.faces.copy(), given.twins.copy(), lengths.copy(), given.free.copy())
    waiting = np.flatnonzero(given.free & (given.twins > np.arange(3 * count))).astype(np.int32)
    room, queued = np.empty(3 * count, np.int32), np.zeros(3 * count, np.uint8)
    room[: len(waiting)], queued[waiting] = waiting, 1
    changed = np.zeros(count, np.uint8)
    flip_to_delaunay(mesh, room, queued, len(waiting), changed)
    given_changed = changed.view(bool)
    thin = _count_thin(mesh[2], np.cos(np.radians(THIN_ANGLE)))
    if thin == 0:
        if not given_changed.any() and lengths is given.lengths:
            return Intrinsic(given, given_changed, given_changed)
        return Intrinsic(HalfEdges(*mesh, given.vertex_count), given_changed, given_changed)
    angle = ROUND_ANGLE if thin > STRETCHED_SHARE * count else THIN_ANGLE
    refined, all_changed = _refined(mesh, given.vertex_count, angle, changed)
    return Intrinsic(refined, all_changed.view(bool), given_changed)


def _refined(
    mesh: tuple[Ints, Ints, Floats, NDArray[np.uint8]], vertices: int, angle: float, changed: NDArray[np.uint8]
) -> tuple[HalfEdges, NDArray[np.uint8]]:
    """Refine until no angle is below `angle` degrees, as far as the number of Steiner points allows."""
    count, most = len(mesh[0]), int(MOST_STEINER * vertices) + STEINER_FLOOR
    larger = count + 2 * most
    faces, twins, lengths, free = mesh
    roomy = (_grown(faces, larger), _grown(twins, 3 * larger), _grown(lengths, 3 * larger), _grown(free, 3 * larger))
    narrow = np.zeros(vertices + most, bool)
    narrow[:vertices] = _angle_sums(faces, lengths, vertices) < np.radians(NARROW)
    work = np.empty(3 * larger, np.int32), np.zeros(3 * larger, np.uint8), np.empty(4 * larger, np.int32)
    grown = _grown(changed, larger)
    faces_now, vertices_now = refine(
        roomy, count, vertices, vertices + most, np.cos(np.radians(angle)), narrow, work, grown
    )
    cut = (array[: (1 if array.ndim == 2 else 3) * faces_now].copy() for array in roomy)
    return HalfEdges(*cut, vertices_now), grown[:faces_now]


def _grown(array: NDArray[np.generic], length: int) -> NDArray[np.generic]:
    larger = np.zeros((length, *array.shape[1:]), array.dtype)
    larger[: len(array)] = array
    return larger


@kernel
def _count_thin(lengths, bound):
    thin = 0
    for side in range(0, len(lengths), 3):
        thin += largest_cosine(lengths[side], lengths[side + 1], lengths[side + 2]) > bound
    return thin


@kernel
def _angle_sums(faces, lengths, count):
    """Return the angle around each vertex, (count,)."""
    sums = np.zeros(count)
    for face in range(len(faces)):
        for i in range(3):
            a, b, c = lengths[3 * face + i], lengths[3 * face + (i + 1) % 3], lengths[3 * face + (i + 2) % 3]
            sums[faces[face, i]] += np.arccos(min(1.0, max(-1.0, (b * b + c * c - a * a) / (2.0 * b * c))))
    return sums
