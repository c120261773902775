"""Stencils of fast marching: for each vertex, the triangles through which it can reach its neighbours.

A stencil entry of vertex A says: with B, the other end of an edge, A can update the target C. The triangle is
laid into the plane with A at the origin and B at (c, 0); C is at (x, y), y >= 0. A corner C with an obtuse
angle lets a front arrive before both A and B are known, so the mesh is unfolded over the edge AB until a vertex
P splits the angle into two acute ones (Kimmel & Sethian 1998, section 4.2); C is then updated from (A, P) and
(P, B) in that unfolded plane.

Nothing here needs a manifold or an orientation: a triangle stands for itself, and over an edge of three faces
or more the unfolding takes one of the other faces.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import reverse_cuthill_mckee

from unbend.arrays import Indices, Ints
from unbend.jit import inlined, kernel
from unbend.mesh.surface import Surface
from unbend.mesh.topology import find_edges
from unbend.tolerances import UNFOLDING_STEPS

ENTRY: Final = np.dtype(
    [("other", np.int32), ("target", np.int32), ("c", np.float64), ("x", np.float64), ("y", np.float64)]
)
"""One stencil entry, 32 bytes: two share a cache line."""

_ENTRIES_PER_FACE = 18  # three corners, each at most split in two, each part used from both of its ends


@dataclass(frozen=True, eq=False)
class Stencils:
    """All stencil entries of a surface, by the vertex that triggers them.

    Vertices are renumbered by reverse Cuthill-McKee, so that a front touches memory that lies together:
    `place[v]` is the number here of the surface's vertex v.
    """

    offsets: Indices  # (n + 1,)
    entries: NDArray[Any]  # (s,) of ENTRY
    place: Ints  # (n,)

    @property
    def vertex_count(self) -> int:
        """Number of vertices, with those that no face uses."""
        return len(self.place)


def build_stencils(surface: Surface) -> Stencils:
    """Build the stencils of `surface`: O(m log m) for m faces."""
    count = len(surface.vertices)
    place = _reverse_cuthill_mckee(surface.faces, count)
    vertices = np.empty_like(surface.vertices)
    vertices[place] = surface.vertices
    faces = place[surface.faces]
    twins = find_edges(faces, count).twins()
    triggers = np.empty(_ENTRIES_PER_FACE * len(faces), np.int32)
    entries = np.empty(len(triggers), ENTRY)
    used = _fill(vertices, faces, twins, triggers, entries, UNFOLDING_STEPS)
    order = np.argsort(triggers[:used], kind="stable")
    offsets = np.zeros(count + 1, np.int64)
    np.cumsum(np.bincount(triggers[:used], minlength=count), out=offsets[1:])
    return Stencils(offsets, entries[:used][order], place)


def _reverse_cuthill_mckee(faces: Ints, count: int) -> Ints:
    rows = faces.ravel()
    columns = np.roll(faces, 1, axis=1).ravel()
    graph = coo_array((np.ones(len(rows), np.int8), (rows, columns)), shape=(count, count)).tocsr()
    order = reverse_cuthill_mckee(graph + graph.T, symmetric_mode=True)
    place = np.empty(count, np.int32)
    place[order] = np.arange(count, dtype=np.int32)
    return place


@inlined
def _length(vertices, a, b):
    dx = vertices[a, 0] - vertices[b, 0]
    dy = vertices[a, 1] - vertices[b, 1]
    dz = vertices[a, 2] - vertices[b, 2]
    return np.sqrt(dx * dx + dy * dy + dz * dz)


@inlined
def _apex(length_a, length_b, base):
    """Place a triangle's third corner over its base from (0, 0) to (base, 0): the law of cosines."""
    if base <= 0.0:
        return 0.0, length_a
    x = (length_a * length_a - length_b * length_b + base * base) / (2.0 * base)
    return x, np.sqrt(max(0.0, length_a * length_a - x * x))


@kernel
def _emit(triggers, entries, used, a, b, target, base, x, y):
    """Write the entry of the wedge (a, b) -> target, seen from a and, mirrored, from b."""
    for end in range(2):
        triggers[used + end] = b if end else a
        entry = entries[used + end]
        entry.other = a if end else b
        entry.target = target
        entry.c = base
        entry.x = base - x if end else x
        entry.y = y
    return used + 2


@kernel
def _split(vertices, faces, twins, half_edge, ax, ay, bx, by, steps):
    """Unfold over `half_edge` until a vertex lies in the cone that splits the obtuse angle at the origin.

    C is at the origin, the ends of the edge at (ax, ay) and (bx, by), with b counter-clockwise of a. Returns
    (vertex, x, y), the vertex -1 where a boundary or the number of steps ends the search.
    """
    cone_ax, cone_ay, cone_bx, cone_by = ax, ay, bx, by
    face, corner = half_edge // 3, half_edge % 3
    a = faces[face, (corner + 1) % 3]
    b = faces[face, (corner + 2) % 3]
    for _ in range(steps):
        twin = twins[half_edge]
        if twin < 0:
            break
        face, corner = twin // 3, twin % 3
        apex = faces[face, corner]
        ex, ey = bx - ax, by - ay
        base = np.sqrt(ex * ex + ey * ey)
        if base <= 0.0:
            break
        x, y = _apex(_length(vertices, a, apex), _length(vertices, b, apex), base)
        # C lies to the left of a -> b, the unfolded triangle to its right
        px = ax + (x * ex + y * ey) / base
        py = ay + (x * ey - y * ex) / base
        acute_a = px * cone_ax + py * cone_ay > 0.0
        acute_b = px * cone_bx + py * cone_by > 0.0
        if acute_a and acute_b:
            return apex, px, py
        # Go on over the edge of the apex that the cone passes through: the one away from the acute side.
        keep = b if acute_a else a
        if acute_a:
            ax, ay, a = px, py, apex
        else:
            bx, by, b = px, py, apex
        half_edge = 3 * face
        for i in range(3):
            first, second = faces[face, (i + 1) % 3], faces[face, (i + 2) % 3]
            if (first == keep and second == apex) or (first == apex and second == keep):
                half_edge = 3 * face + i
    return -1, 0.0, 0.0


@kernel
def _fill(vertices, faces, twins, triggers, entries, steps):
    used = 0
    for half_edge in range(3 * len(faces)):
        face, corner = half_edge // 3, half_edge % 3
        target = faces[face, corner]
        a = faces[face, (corner + 1) % 3]
        b = faces[face, (corner + 2) % 3]
        length_a = _length(vertices, a, target)
        length_b = _length(vertices, b, target)
        base = _length(vertices, a, b)
        x, y = _apex(length_a, length_b, base)
        if length_a * length_a + length_b * length_b < base * base and y > 0.0:
            # The target at the origin, the edge below it from (-x, -y) to (base - x, -y): a is clockwise of b
            # seen from the target only after a half turn, so the edge is laid above, at (x, y) and (x - base, y).
            split, px, py = _split(vertices, faces, twins, half_edge, x, y, x - base, y, steps)
            if split >= 0:
                from_a = np.sqrt((px - x) ** 2 + (py - y) ** 2)
                from_b = np.sqrt((px - x + base) ** 2 + (py - y) ** 2)
                length_p = np.sqrt(px * px + py * py)
                x_a, y_a = _apex(length_a, length_p, from_a)
                used = _emit(triggers, entries, used, a, split, target, from_a, x_a, y_a)
                x_b, y_b = _apex(length_p, length_b, from_b)
                used = _emit(triggers, entries, used, split, b, target, from_b, x_b, y_b)
        # The undivided triangle stays: it is exact where both ends are known in time, where the
        # unfolded ones may not be.
        used = _emit(triggers, entries, used, a, b, target, base, x, y)
    return used
