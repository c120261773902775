"""A triangulation as half-edges with twins and lengths, without coordinates.

Half-edge `3 f + i` is the side of face f opposite its corner i; `twins` has the half-edge on the other side, as in
`unbend.mesh.topology`. Faces are in the order of a walk over the surface (`walk.py`), and reoriented until both faces
of each edge agree, as far as the surface is orientable. Edges whose two faces agree are *free*: they can be flipped and
crossed without comparing vertices.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from unbend.arrays import Floats, Ints
from unbend.geodesics.unfolding import half_edge_lengths
from unbend.geodesics.walk import sort_rings, walk_faces
from unbend.jit import inlined, kernel
from unbend.mesh.surface import Surface

Mesh = tuple[Ints, Ints, Floats, NDArray[np.uint8]]
"""Arrays that kernels read and write: faces, twins, lengths, free."""


@dataclass(frozen=True, eq=False)
class HalfEdges:
    """Triangles with lengths. Vertices after those of the surface are Steiner points, which only marching uses."""

    faces: Ints  # (m, 3) int32
    twins: Ints  # (3 m,) int32
    lengths: Floats  # (3 m,)
    free: NDArray[np.uint8]  # (3 m,) 1 for half-edges of free edges
    vertex_count: int

    @property
    def arrays(self) -> Mesh:
        """The arrays that kernels take."""
        return self.faces, self.twins, self.lengths, self.free


def half_edges_of(surface: Surface, unit: float) -> HalfEdges:
    """Return the triangles of `surface`, ordered and oriented, with lengths in units of `unit`: O(n + m)."""
    lengths = half_edge_lengths(surface.vertices / surface.scale, surface.faces) * (surface.scale / unit)
    twins = sort_rings(surface.faces, surface.edges.twins(), lengths)
    faces, twins, lengths = _in_order(surface.faces, twins, lengths, *walk_faces(surface.faces, twins, lengths))
    return HalfEdges(faces, twins, lengths, _free(faces, twins), len(surface.vertices))


@inlined
def following(half_edge):
    """Return the next half-edge around the face."""
    return half_edge - 2 if half_edge % 3 == 2 else half_edge + 1


@inlined
def before(half_edge):
    """Return the half-edge before this one around the face."""
    return half_edge + 2 if half_edge % 3 == 0 else half_edge - 1


@kernel
def _in_order(faces, twins, lengths, entries, turned):
    """Return the arrays with faces in the order of a walk, each starting with the side where the walk entered it."""
    place = np.empty(len(twins), np.int32)
    for face in range(len(entries)):
        for step in range(3):
            place[_side(entries[face], step, turned[face])] = 3 * face + step
    new_faces, new_twins, new_lengths = np.empty_like(faces), np.empty_like(twins), np.empty_like(lengths)
    for face in range(len(entries)):
        for step in range(3):
            side = _side(entries[face], step, turned[face])
            new_faces[face, step] = faces[side // 3, side % 3]
            new_twins[3 * face + step] = place[twins[side]] if twins[side] >= 0 else -1
            new_lengths[3 * face + step] = lengths[side]
    return new_faces, new_twins, new_lengths


@inlined
def _side(entry, step, turned):
    """Return the half-edge `step` after `entry` around its face, or before it where the face is reversed."""
    return 3 * (entry // 3) + (entry % 3 + (3 - step if turned else step)) % 3


@kernel
def _free(faces, twins):
    free = np.zeros(len(twins), np.uint8)
    for half_edge in range(len(twins)):
        twin = twins[half_edge]
        if twin >= 0 and twins[twin] == half_edge and twin // 3 != half_edge // 3:
            face, i, other, j = half_edge // 3, half_edge % 3, twin // 3, twin % 3
            tail, head = faces[face, (i + 1) % 3], faces[face, (i + 2) % 3]
            free[half_edge] = tail == faces[other, (j + 2) % 3] and head == faces[other, (j + 1) % 3]
    return free


@inlined
def ring_before(twins, half_edge):
    """Return the half-edge whose twin is `half_edge`, -1 on the boundary."""
    last = twins[half_edge]
    if last >= 0:
        while twins[last] != half_edge:
            last = twins[last]
    return last


@kernel
def relink(twins, old, new, beyond, ahead):
    """Replace half-edges `old` by `new`: the twins of `old` were `beyond`, and `old` were the twins of `ahead`."""
    for k in range(len(old)):
        twins[new[k]] = beyond[k]
    for k in range(len(old)):
        last = ahead[k]
        for q in range(len(old)):
            if last == old[q]:
                last = new[q]
                break
        if last >= 0:
            twins[last] = new[k]
