"""Stencils of fast marching: around each vertex, the triangles through which a front can reach it.

A *slot* of vertex C is a triangle (C, A, B) laid into the plane with C at the origin, A on the x axis and B above
it, and behind the edge AB the vertex P that C looks at when the mesh is unfolded there. A front reaches C between A
and P or between P and B. Kimmel & Sethian (1998) unfold only where the angle at C is obtuse, so that A and P, and P
and B, are known before C. Here every corner is unfolded: the two halves see a front's curvature better than the
triangle does, which more than halves the error (docs/benchmarks.md).

Eight slots make a block, laid out so that one vector instruction takes a row of it; most vertices have one block of
256 bytes. Empty slots refer to a vertex that no front reaches.

Nothing here needs a manifold or an orientation: a triangle stands for itself, and over an edge of three faces
or more the unfolding takes one of the other faces.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from unbend.arrays import Floats, Ints
from unbend.errors import MeshGeometryError
from unbend.geodesics.unfolding import half_edge_lengths, vertex_behind
from unbend.jit import kernel
from unbend.mesh.surface import Surface
from unbend.tolerances import DEGENERATE_BASE, LONGEST_EDGE, NEEDLE

SLOTS: Final = 8
"""Slots in a block: the 8 floats of one AVX register; a vertex of a mesh has 6 triangles on average."""

A, B, P, AX, BX, BY, PX, PY = range(8)  # the rows of a block
BLOCK_BYTES: Final = 8 * SLOTS * 4
LINE_BYTES: Final = 64  # of a cache line


@dataclass(frozen=True, eq=False)
class Stencils:
    """All slots of a surface.

    Vertices are renumbered breadth first, so that a front touches memory that lies together: `place[v]` is the
    number here of the surface's vertex v. Lengths are in units of the median edge, in single precision.
    """

    first: Ints  # (n + 1,) int32: vertex v has blocks first[v] to first[v + 1]
    corners: Ints  # (b, 8, SLOTS) int32: rows A, B, P; A takes in every neighbour; n where there is none
    shapes: NDArray[np.float32]  # the same memory: rows AX to PY, coordinates of A, B and P
    place: Ints  # (n,) int32
    unit: float  # length of the median edge
    face_count: int
    points: Floats  # (n, 3): the surface's vertices, as it numbers them and in its units

    @property
    def vertex_count(self) -> int:
        """Number of vertices, with those that no face uses."""
        return len(self.place)

    @property
    def arrays(self) -> tuple[Ints, Ints, NDArray[np.float32]]:
        """What kernels read: first, corners, shapes."""
        return self.first, self.corners, self.shapes


_built: WeakKeyDictionary[Surface, Stencils] = WeakKeyDictionary()


def stencils_of(surface: Surface) -> Stencils:
    """Return the stencils of `surface`, built at the first call and kept as long as it lives."""
    found = _built.get(surface)
    if found is None:
        found = _built[surface] = build_stencils(surface)
    return found


def build_stencils(surface: Surface) -> Stencils:
    """Build the stencils of `surface`: O(n + m) for n vertices and m faces."""
    count = len(surface.vertices)
    twins = surface.edges.twins()
    starts, around = _corners_of_vertices(surface.faces, count)
    order = _breadth_first(surface.faces, starts, around)
    place = np.empty(count, np.int32)
    place[order] = np.arange(count, dtype=np.int32)
    lengths, unit = _lengths(surface)
    first = np.zeros(count + 1, np.int32)
    _count_blocks(surface.faces, starts, around, order, first)
    corners, shapes = _empty_blocks(int(first[-1]), count)
    _fill(lengths, surface.faces, twins, starts, around, order, place, first, corners, shapes)
    return Stencils(first, corners, shapes, place, unit, len(surface.faces), surface.vertices)


def _empty_blocks(number: int, nothing: int) -> tuple[Ints, NDArray[np.float32]]:
    """Return blocks that begin at cache lines, as their corners and as their shapes."""
    memory = np.empty(number * BLOCK_BYTES + LINE_BYTES, np.uint8)
    start = -memory.ctypes.data % LINE_BYTES
    corners = memory[start : start + number * BLOCK_BYTES].view(np.int32).reshape(number, 8, SLOTS)
    corners[:, : P + 1] = nothing
    corners[:, P + 1 :] = 0
    return corners, corners.view(np.float32)


def _lengths(surface: Surface) -> tuple[Floats, float]:
    """Return the lengths of half-edges in units of the median edge, (3 m,), and that unit."""
    lengths = half_edge_lengths(surface.vertices / surface.scale, surface.faces)
    typical = float(np.median(lengths)) or float(lengths.mean()) or 1.0  # a few long edges must not make others vanish
    lengths /= typical
    longest = int(lengths.argmax())
    if lengths[longest] > LONGEST_EDGE:
        raise MeshGeometryError(
            f"face {longest // 3} has an edge {lengths[longest]:.3g} times as long as a typical one: "
            f"distances are marched in single precision, which has room for {LONGEST_EDGE:.0e}"
        )
    return lengths, surface.scale * typical


@kernel
def _corners_of_vertices(faces, count):
    """Return, for each vertex v, its corners 3 f + i as around[starts[v]:starts[v + 1]]."""
    starts = np.zeros(count + 2, np.int32)
    for face in range(len(faces)):
        for corner in range(3):
            starts[faces[face, corner] + 2] += 1
    for vertex in range(2, count + 2):
        starts[vertex] += starts[vertex - 1]
    around = np.empty(3 * len(faces), np.int32)
    for face in range(len(faces)):
        for corner in range(3):
            vertex = faces[face, corner]
            around[starts[vertex + 1]] = 3 * face + corner
            starts[vertex + 1] += 1
    return starts[: count + 1], around


@kernel
def _breadth_first(faces, starts, around):
    """Return the vertices in breadth-first order, component by component."""
    count = len(starts) - 1
    order = np.empty(count, np.int32)
    seen = np.zeros(count, np.bool_)
    size = 0
    for seed in range(count):
        if seen[seed]:
            continue
        seen[seed] = True
        order[size] = seed
        head = size
        size += 1
        while head < size:
            vertex = order[head]
            head += 1
            for index in range(starts[vertex], starts[vertex + 1]):
                face = around[index] // 3
                for corner in range(3):
                    other = faces[face, corner]
                    if not seen[other]:
                        seen[other] = True
                        order[size] = other
                        size += 1
    return order


@kernel
def _count_blocks(faces, starts, around, order, first):
    """Count slots: one a triangle, and one for each neighbour that would appear as B only."""
    seen_by = np.full(len(order), -1, np.int32)
    for rank in range(len(order)):
        vertex = order[rank]
        slots = starts[vertex + 1] - starts[vertex]
        for turn in range(1, 3):
            for index in range(starts[vertex], starts[vertex + 1]):
                other = faces[around[index] // 3, (around[index] + turn) % 3]
                if turn == 2 and seen_by[other] != vertex:
                    slots += 1
                seen_by[other] = vertex
        first[rank + 1] = first[rank] + (slots + SLOTS - 1) // SLOTS


@kernel
def _fill(lengths, faces, twins, starts, around, order, place, first, corners, shapes):
    nothing = len(order)
    seen_by = np.full(len(order), -1, np.int32)
    for rank in range(len(order)):
        c = order[rank]
        slot = 0
        for index in range(starts[c], starts[c + 1]):
            half_edge = around[index]
            face, corner = half_edge // 3, half_edge % 3
            a, b = faces[face, (corner + 1) % 3], faces[face, (corner + 2) % 3]
            base = lengths[half_edge]
            from_b, from_a = lengths[3 * face + (corner + 1) % 3], lengths[3 * face + (corner + 2) % 3]
            bx, by = 0.0, from_b
            if from_a > 0.0:
                bx = (from_a * from_a + from_b * from_b - base * base) / (2.0 * from_a)
                by = np.sqrt(max(0.0, from_b * from_b - bx * bx))
            # Over a boundary edge nothing comes, over one without length only what comes along CA, and a needle's far
            # end is too far to tell directions by: no segments.
            p, px, py = nothing, 0.0, 0.0
            bent = base > DEGENERATE_BASE * (from_a + from_b) and base < NEEDLE * min(from_a, from_b)
            if twins[half_edge] >= 0 and bent:
                p, px, py = -1, 0.0, 0.0
                if by > 0.0:
                    p, px, py = vertex_behind(lengths, faces, twins, half_edge, from_a, bx, by)
                if p < 0 or max(abs(px), abs(py)) > NEEDLE * min(
                    from_a, from_b
                ):  # the whole triangle, and one with no base
                    p, px, py = b, bx, by
                p = int(place[p])
            block, lane = first[rank] + slot // SLOTS, slot % SLOTS
            corners[block, A, lane], corners[block, B, lane], corners[block, P, lane] = place[a], place[b], p
            shapes[block, AX, lane], shapes[block, BX, lane], shapes[block, BY, lane] = from_a, bx, by
            shapes[block, PX, lane], shapes[block, PY, lane] = px, py
            seen_by[a] = c
            slot += 1
        for index in range(starts[c], starts[c + 1]):
            face, corner = around[index] // 3, around[index] % 3
            b = faces[face, (corner + 2) % 3]
            if seen_by[b] != c:
                seen_by[b] = c
                block, lane = first[rank] + slot // SLOTS, slot % SLOTS
                corners[block, A, lane] = place[b]
                shapes[block, AX, lane] = lengths[3 * face + (corner + 1) % 3]
                slot += 1
