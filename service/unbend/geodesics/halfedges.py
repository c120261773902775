"""A triangulation described by lengths alone: which triangles meet at which sides, and how long the sides are.

Side `3 f + i` of face f lies opposite its corner i and is a half-edge; `twins` names the half-edge beyond it, as
`unbend.mesh.topology` does. Faces are turned around until both faces of each edge agree, as far as the surface can be
oriented. Edges whose two faces agree are *free*: they may be flipped and crossed without looking at vertices.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from unbend.arrays import Floats, Ints
from unbend.geodesics.unfolding import half_edge_lengths
from unbend.jit import inlined, kernel
from unbend.mesh.surface import Surface

Mesh = tuple[Ints, Ints, Floats, NDArray[np.uint8]]
"""Arrays that kernels read and write: faces, twins, lengths, free."""


@dataclass(frozen=True, eq=False)
class HalfEdges:
    """Triangles with lengths. Vertices behind those of the surface are Steiner points, which only marching sees."""

    faces: Ints  # (m, 3) int32
    twins: Ints  # (3 m,) int32
    lengths: Floats  # (3 m,)
    free: NDArray[np.uint8]  # (3 m,) 1 for half-edges of free edges
    vertex_count: int

    @property
    def arrays(self) -> Mesh:
        """The arrays alone."""
        return self.faces, self.twins, self.lengths, self.free


def half_edges_of(surface: Surface, unit: float) -> HalfEdges:
    """Return the triangles of `surface` as they are, oriented, with lengths in units of `unit`: O(n + m)."""
    twins = surface.edges.twins()
    lengths = half_edge_lengths(surface.vertices / surface.scale, surface.faces) * (surface.scale / unit)
    count = len(surface.faces)
    turned = _turned(surface.faces, twins, np.zeros(count, np.int8), np.empty(count, np.int32))
    faces, twins, lengths = _oriented(surface.faces, twins, lengths, turned)
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
def _turned(faces, twins, turned, waiting):
    """Say for each face whether it must be turned around: 2 if so, 1 if not."""
    for seed in range(len(faces)):
        if turned[seed]:
            continue
        turned[seed] = 1
        waiting[0], size = seed, 1
        while size:
            size -= 1
            face = waiting[size]
            for i in range(3):
                twin = twins[3 * face + i]
                if twin < 0 or twins[twin] != 3 * face + i or turned[twin // 3]:
                    continue
                other, j = twin // 3, twin % 3
                alike = faces[face, (i + 1) % 3] == faces[other, (j + 2) % 3]
                turned[other] = turned[face] if alike else 3 - turned[face]
                waiting[size] = other
                size += 1
    return turned


@kernel
def _oriented(faces, twins, lengths, turned):
    new_faces, new_twins, new_lengths = faces.copy(), twins.copy(), lengths.copy()
    for face in range(len(faces)):
        if turned[face] == 2:
            new_faces[face, 1], new_faces[face, 2] = faces[face, 2], faces[face, 1]
            for one, other in ((1, 2), (2, 1)):
                new_lengths[3 * face + one] = lengths[3 * face + other]
                new_twins[3 * face + one] = twins[3 * face + other]
    for half_edge in range(len(twins)):
        twin = new_twins[half_edge]
        if twin >= 0 and twin % 3 and turned[twin // 3] == 2:
            new_twins[half_edge] = 3 * (twin // 3) + 3 - twin % 3
    return new_faces, new_twins, new_lengths


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
    """Put half-edges `new` in place of `old`: the twins of `old` were `beyond`, and `old` were the twins of `ahead`."""
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
