"""The intrinsic triangulation for marching: the same surface with rounder triangles.

On stretched triangles, marching errors are as large as the distances. An intrinsic triangulation of the same surface
has the same distances and better triangles: flips make it Delaunay, and Steiner points improve the rest
(Sharp, Soliman & Crane 2019, "Navigating intrinsic triangulations").
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unbend.geodesics.flips import flip_to_delaunay, mollified
from unbend.geodesics.halfedges import HalfEdges, Mesh
from unbend.geodesics.refinement import largest_cosine, refine
from unbend.geodesics.unfolding import angle
from unbend.jit import kernel
from unbend.tolerances import MOST_STEINER, NARROW, ROUND_ANGLE, STEINER_FLOOR, STRETCHED_SHARE, THIN_ANGLE


@dataclass(frozen=True, eq=False)
class Intrinsic:
    """An intrinsic triangulation, and which of the given faces it replaced."""

    half_edges: HalfEdges
    changed: NDArray[np.uint8]  # (m,) 1 for each given face that flips or Steiner points replaced


def intrinsic_triangulation(given: HalfEdges) -> Intrinsic:
    """Return the triangulation for marching, which is the given one if that needs no change.

    Vertices keep their numbers, and Steiner points follow them. Angles below `THIN_ANGLE` are always refined. If many
    such angles are left after all flips, as on CAD models and steep height maps, all angles below `ROUND_ANGLE` are
    refined.
    """
    count = len(given.faces)
    lengths = mollified(given.lengths)
    mesh = given.faces.copy(), given.twins.copy(), lengths.copy(), given.free.copy()
    waiting, queued = np.empty(3 * count, np.int32), np.zeros(3 * count, np.uint8)
    once = np.flatnonzero(given.free & (given.twins > np.arange(3 * count)))
    waiting[: len(once)], queued[once] = once, 1
    changed = np.zeros(count, np.uint8)
    flip_to_delaunay(mesh, waiting, queued, len(once), changed)
    thin = _count_thin(mesh[2], _cosine(THIN_ANGLE))
    if thin:
        angle = ROUND_ANGLE if thin > STRETCHED_SHARE * count else THIN_ANGLE
        refined, changed = _refined(mesh, given.vertex_count, angle, thin, changed)
        return Intrinsic(refined, changed[:count])
    if changed.any() or lengths is not given.lengths:
        return Intrinsic(HalfEdges(*mesh, given.vertex_count), changed)
    return Intrinsic(given, changed)


def _refined(
    mesh: Mesh, vertices: int, angle: float, thin: int, changed: NDArray[np.uint8]
) -> tuple[HalfEdges, NDArray[np.uint8]]:
    """Refine until no angle is below `angle` degrees, as far as the number of Steiner points allows.

    Arrays grow with the number of points, because arrays for the maximum number would be several times the mesh.
    """
    count, now, most = len(mesh[0]), vertices, vertices + int(MOST_STEINER * vertices) + STEINER_FLOOR
    narrow = _angle_sums(mesh[0], mesh[2], vertices) < np.radians(NARROW)
    extra = 4 * thin + 64
    while True:
        capacity, limit = count + 2 * extra, min(most, now + extra)
        mesh = (
            _longer(mesh[0], capacity),
            _longer(mesh[1], 3 * capacity),
            _longer(mesh[2], 3 * capacity),
            _longer(mesh[3], 3 * capacity),
        )
        work = np.empty(3 * capacity, np.int32), np.zeros(3 * capacity, np.uint8), np.empty(4 * capacity, np.int32)
        changed = _longer(changed, capacity)
        count, now = refine(mesh, count, now, limit, _cosine(angle), _longer(narrow, limit), work, changed)
        if now < limit or now == most:
            faces, twins, lengths, free = mesh
            sides = twins[: 3 * count].copy(), lengths[: 3 * count].copy(), free[: 3 * count].copy()
            return HalfEdges(faces[:count].copy(), *sides, now), changed
        extra *= 4


def _cosine(degrees: float) -> float:
    return float(np.cos(np.radians(degrees)))


def _longer(array: Any, length: int) -> Any:
    """Return an array with zeros added until it has `length` rows."""
    longer = np.zeros((length, *array.shape[1:]), array.dtype)
    longer[: len(array)] = array
    return longer


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
            sums[faces[face, i]] += angle(b, c, a)
    return sums
