"""A triangulation as half-edges with lengths, without coordinates.

Half-edge `3 f + i` is the side of face f opposite its corner i. The half-edges of one edge form a cycle, and `twins`
has the next half-edge in that cycle, or -1 on the boundary, as in `unbend.mesh.topology`. At an edge of two faces the
next half-edge is the one on the other side.

Faces are in the order of a walk over the surface (`walk.py`), which also orients them consistently, as far as the
surface is orientable. An edge is *free* if it has exactly two faces and their orientations agree. Kernels flip and
cross free edges without comparing vertices.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from unbend.arrays import Floats, Ints
from unbend.geodesics.unfolding import half_edge_lengths
from unbend.geodesics.walk import sort_cycles, walk_faces
from unbend.jit import inlined, kernel
from unbend.mesh.surface import Surface

Mesh = tuple[Ints, Ints, Floats, NDArray[np.uint8]]
"""Arrays that kernels read and write: faces, twins, lengths, free."""


@dataclass(frozen=True, eq=False)
class HalfEdges:
    """Triangles with lengths. Vertices numbered after those of the surface are Steiner points for marching."""

    faces: Ints  # (m, 3) int32
    twins: Ints  # (3 m,) int32: the next half-edge of the same edge, cyclically; -1 on the boundary
    lengths: Floats  # (3 m,)
    free: NDArray[np.uint8]  # (3 m,): 1 for half-edges of free edges
    vertex_count: int

    @property
    def arrays(self) -> Mesh:
        """The arrays that kernels take."""
        return self.faces, self.twins, self.lengths, self.free


def half_edges_of(surface: Surface, unit: float) -> HalfEdges:
    """Return the triangles of `surface`, ordered and oriented, with lengths in units of `unit`: O(n + m)."""
    lengths = half_edge_lengths(surface.vertices / surface.scale, surface.faces) * (surface.scale / unit)
    twins = sort_cycles(surface.faces, surface.edges.twins(), lengths)
    faces, twins, lengths = _in_order(surface.faces, twins, lengths, *walk_faces(surface.faces, twins, lengths))
    return HalfEdges(faces, twins, lengths, _free(faces, twins), len(surface.vertices))


def typical_length(lengths: Floats) -> float:
    """Return the median length; if it is 0, the median of the positive lengths; if all are 0, 0.

    The mean would not do, because a few long edges raise it far above the lengths of all other edges.
    """
    typical = float(np.median(lengths))
    if typical == 0.0 and lengths.any():
        typical = float(np.median(lengths[lengths > 0.0]))
    return typical


@inlined
def following(half_edge):
    """Return the next half-edge around the face."""
    return half_edge - 2 if half_edge % 3 == 2 else half_edge + 1


@inlined
def before(half_edge):
    """Return the previous half-edge around the face."""
    return half_edge + 2 if half_edge % 3 == 0 else half_edge - 1


@kernel
def _in_order(faces, twins, lengths, entries, turned):
    """Reorder the faces as a walk entered them; half-edge 0 of each face is the one over which the walk entered."""
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
    """Return the half-edge `step` places after `entry` around its face; before `entry` if the face is `turned`."""
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
def previous_in_cycle(twins, half_edge):
    """Return the half-edge that `half_edge` follows in the cycle of its edge, -1 on the boundary."""
    previous = twins[half_edge]
    if previous >= 0:
        while twins[previous] != half_edge:
            previous = twins[previous]
    return previous


@kernel
def relink(twins, old, new, nexts, previous):
    """Put half-edges `new` in the places of `old` in the cycles of their edges.

    `nexts` and `previous` are the next and the previous half-edge of each of `old` in its cycle, -1 on the boundary.
    Callers read them before they change the faces.
    """
    for k in range(len(old)):
        twins[new[k]] = nexts[k]
    for k in range(len(old)):
        last = previous[k]
        for q in range(len(old)):
            if last == old[q]:
                last = new[q]
                break
        if last >= 0:
            twins[last] = new[k]
