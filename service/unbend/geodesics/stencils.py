"""Stencils of fast marching: the triangles through which a front can reach each vertex.

A *slot* of vertex C is a triangle (C, A, B) in the plane with C at the origin, A on the x axis and B above that axis,
and the vertex P that is visible from C behind the edge AB when the mesh is unfolded there. A front reaches C between A
and P or between P and B. Kimmel & Sethian (1998) unfold only where the angle at C is obtuse, so that the values at A
and P, or at P and B, are known before the value at C. Here every corner is unfolded: the two halves represent a
front's curvature better than the whole triangle, which more than halves the error (docs/benchmarks/distances.md).

Eight slots make a block, so that one vector instruction processes a row of a block. Most vertices have one block of 256
bytes. Empty slots refer to a vertex that no front reaches.

The triangles come from the intrinsic triangulation. Where it differs from the given one, given triangles fill otherwise
empty slots. Both triangulate the same surface, so all slots are valid. More slots reduce the error at no cost.

The surface need not be manifold or oriented: each triangle is independent. Over an edge of three faces or more, the
unfolding continues into one of the other faces.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from unbend.arrays import Floats, Ints
from unbend.errors import MeshGeometryError
from unbend.geodesics.halfedges import HalfEdges, half_edges_of, typical_length
from unbend.geodesics.intrinsic import Intrinsic, intrinsic_triangulation
from unbend.geodesics.unfolding import angle, apex, half_edge_lengths, vertex_behind
from unbend.jit import borrowing, kernel
from unbend.mesh.surface import Surface
from unbend.tolerances import DEGENERATE_BASE, LONGEST_EDGE, NEEDLE

SLOTS: Final = 8
"""Slots in a block: the 8 floats of one AVX register. A vertex has 6 triangles on average."""

A, B, P, AX, BX, BY, PX, PY = range(8)  # the rows of a block
BLOCK_BYTES: Final = 8 * SLOTS * 4
LINE_BYTES: Final = 64  # size of a cache line
_MOST_TRIED: Final = 64  # maximum number of given triangles around a vertex that are considered for empty slots


Triangles = tuple[Ints, Ints, Floats, Ints, Ints, Floats]
"""Arrays that `start_front` reads.

They are the faces (m, 3), twins (3 m,) and lengths (3 m,) of half-edges, starts (k + 1,), corners (3 m,) and angles
(k,). The corners of vertex v are corners[starts[v]:starts[v + 1]]. See `_angles_around` for the angles.
"""


@dataclass(frozen=True, eq=False)
class Stencils:
    """All slots of a surface, and the triangles they come from.

    Vertices are renumbered breadth first, so that a front touches nearby memory. `place[v]` is the new number of the
    surface's vertex v. The new numbers also include Steiner points. Lengths are in units of the median edge; the slots
    have single precision.
    """

    first: Ints  # (k + 1,) int32: vertex v has the blocks from first[v] to first[v + 1] - 1
    corners: Ints  # (b, 8, SLOTS) int32: rows A, B, P; every neighbour is an A of some slot; k in empty slots
    shapes: NDArray[np.float32]  # the same memory: rows AX to PY, coordinates of A, B and P
    place: Ints  # (n,) int32
    unit: float  # length of the median edge
    triangles: Triangles
    points: Floats  # (n, 3): the surface's vertices, in its own numbering and units

    @property
    def vertex_count(self) -> int:
        """Number of vertices k, including Steiner points and vertices without a face."""
        return len(self.first) - 1

    @property
    def face_count(self) -> int:
        """Number of intrinsic triangles."""
        return len(self.triangles[0])

    @property
    def arrays(self) -> tuple[tuple[Ints, Ints, NDArray[np.float32]], Triangles]:
        """Arrays that kernels read: first, corners and shapes for `march`, the triangles for `start_front`."""
        return (self.first, self.corners, self.shapes), self.triangles


_built: WeakKeyDictionary[Surface, Stencils] = WeakKeyDictionary()


def stencils_of(surface: Surface) -> Stencils:
    """Return the stencils of `surface`, built at the first call and cached for the lifetime of the surface."""
    found = _built.get(surface)
    if found is None:
        found = _built[surface] = build_stencils(surface)
    return found


def build_stencils(surface: Surface, *, intrinsic: bool = True) -> Stencils:
    """Build the stencils of `surface`, in O(n + m) for n vertices and m faces plus the time of flips and refinement.

    Benchmarks turn `intrinsic` off: the stencils then use only the given triangles.
    """
    unit = _median_edge(surface)
    given = half_edges_of(surface, unit)
    found = intrinsic_triangulation(given) if intrinsic else Intrinsic(given, np.zeros(len(given.faces), np.uint8))
    return _stencils(surface, given, found, unit)


def _stencils(surface: Surface, given: HalfEdges, intrinsic: Intrinsic, unit: float) -> Stencils:
    mesh = intrinsic.half_edges
    count = mesh.vertex_count
    starts, around = _corners_of_vertices(mesh.faces, count)
    order = _breadth_first(mesh.faces, starts, around)
    place = np.empty(count, np.int32)
    place[order] = np.arange(count, dtype=np.int32)
    first = np.zeros(count + 1, np.int32)
    _count_blocks(mesh.arrays, starts, around, order, first)
    corners, shapes = _empty_blocks(int(first[-1]), count)
    filled = np.zeros(count, np.int32)
    _fill(mesh.arrays, starts, around, order, place, first, corners, shapes, filled)
    if intrinsic.changed.any():
        given_starts, given_around = _corners_of_vertices(given.faces, count)
        _fill_empty(
            given.arrays, intrinsic.changed, given_starts, given_around, order, place, first, corners, shapes,
            filled,
        )  # fmt: skip
    starts, around = _placed_corners(starts, around, order)
    angles = _angles_around(mesh.arrays, starts, around, place[mesh.faces].ravel())
    triangles = place[mesh.faces], mesh.twins, mesh.lengths, starts, around, angles
    return Stencils(first, corners, shapes, place[: len(surface.vertices)].copy(), unit, triangles, surface.vertices)


def _empty_blocks(number: int, nothing: int) -> tuple[Ints, NDArray[np.float32]]:
    """Return blocks aligned to cache lines, as corners and as shapes."""
    memory = np.empty(number * BLOCK_BYTES + LINE_BYTES, np.uint8)
    start = -memory.ctypes.data % LINE_BYTES
    corners = memory[start : start + number * BLOCK_BYTES].view(np.int32).reshape(number, 8, SLOTS)
    corners[:, : P + 1] = nothing
    corners[:, P + 1 :] = 0
    return corners, corners.view(np.float32)


def _median_edge(surface: Surface) -> float:
    """Return the typical length of an edge, which becomes the unit.

    Raise MeshGeometryError if an edge is too long for single precision.
    """
    lengths = half_edge_lengths(surface.vertices / surface.scale, surface.faces)
    typical = typical_length(lengths) or 1.0
    longest = int(lengths.argmax())
    if lengths[longest] > LONGEST_EDGE * typical:
        raise MeshGeometryError(
            f"face {longest // 3} has an edge {lengths[longest] / typical:.3g} times as long as a typical one: "
            f"distances are computed in single precision, which allows a ratio of {LONGEST_EDGE:.0e}"
        )
    return surface.scale * typical


@kernel
def _corners_of_vertices(faces, count):
    """Return arrays `starts` and `around`: around[starts[v]:starts[v + 1]] are the corners 3 f + i of vertex v."""
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
def _placed_corners(starts, around, order):
    """Return `starts` and `around` with vertices renumbered by their places in `order`."""
    new_starts, new_around = np.empty(len(starts), np.int32), np.empty(len(around), np.int32)
    size = 0
    for rank in range(len(order)):
        new_starts[rank] = size
        for index in range(starts[order[rank]], starts[order[rank] + 1]):
            new_around[size] = around[index]
            size += 1
    new_starts[len(order)] = size
    return new_starts, new_around


@kernel
def _angles_around(mesh, starts, around, rank_of):
    """Return the angle around each vertex.

    The angle is inf at a vertex whose corners do not form a single closed fan of free edges. It is -1 at the corners of
    a triangle with a side so short, compared with the others, that rounding dominates its angles.
    """
    _, twins, lengths, free = mesh
    angles = np.zeros(len(starts) - 1)
    for vertex in range(len(angles)):
        size = starts[vertex + 1] - starts[vertex]
        total = 0.0
        corner = around[starts[vertex]] if size else -1
        for turn in range(size):
            face, i = corner // 3, corner % 3
            side = 3 * face + (i + 2) % 3
            a, b, c = lengths[corner], lengths[3 * face + (i + 1) % 3], lengths[side]
            total += angle(b, c, a) if b * c > 0.0 else 0.0
            twin = twins[side]
            corner = 3 * (twin // 3) + (twin % 3 + 2) % 3
            back = corner == around[starts[vertex]]
            if not free[side] or back != (turn == size - 1):
                total = np.inf
                break
        angles[vertex] = total
    for side in range(0, len(lengths), 3):
        a, b, c = lengths[side], lengths[side + 1], lengths[side + 2]
        if min(a, b, c) <= DEGENERATE_BASE * max(a, b, c):
            for corner in range(side, side + 3):
                angles[rank_of[corner]] = -1.0
    return angles


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
def _count_blocks(mesh, starts, around, order, first):
    """Count slots: one per triangle, and one per edge of the vertex that would otherwise not be the CA of a slot."""
    _, _, _, free = mesh
    for rank in range(len(order)):
        vertex = order[rank]
        slots = starts[vertex + 1] - starts[vertex]
        for index in range(starts[vertex], starts[vertex + 1]):
            corner = around[index]
            slots += free[3 * (corner // 3) + (corner % 3 + 1) % 3] == 0
        first[rank + 1] = first[rank] + (slots + SLOTS - 1) // SLOTS


@borrowing
def _slot_of(mesh, half_edge):
    """Return the slot of the corner C opposite `half_edge`: A, B, P and their coordinates.

    P is -1 if no front can cross AB.
    """
    faces, twins, lengths, _ = mesh
    face, corner = half_edge // 3, half_edge % 3
    a, b = faces[face, (corner + 1) % 3], faces[face, (corner + 2) % 3]
    base = lengths[half_edge]
    from_b, from_a = lengths[3 * face + (corner + 1) % 3], lengths[3 * face + (corner + 2) % 3]
    bx, by = 0.0, from_b
    if from_a > 0.0:
        bx, by = apex(from_b, base, from_a)
    # Three kinds of edges get no P: boundary edges, which no front crosses; edges of zero length, because a front comes
    # along CA instead; and the far sides of needles, which are too far away to have a direction.
    p, px, py = -1, 0.0, 0.0
    if twins[half_edge] >= 0 and base > DEGENERATE_BASE * (from_a + from_b) and base < NEEDLE * min(from_a, from_b):
        if by > 0.0:
            p, px, py = vertex_behind(lengths, faces, twins, half_edge, from_a, bx, by)
        if p < 0 or max(abs(px), abs(py)) > NEEDLE * min(from_a, from_b):
            p, px, py = b, bx, by  # the half between A and P is then the whole triangle, the other half is empty
    return a, b, p, from_a, bx, by, px, py


@borrowing
def _fill(mesh, starts, around, order, place, first, corners, shapes, filled):
    faces, _, lengths, free = mesh
    nothing = len(order)
    for rank in range(len(order)):
        c = order[rank]
        slot = 0
        for index in range(starts[c], starts[c + 1]):
            a, b, p, ax, bx, by, px, py = _slot_of(mesh, around[index])
            block, lane = first[rank] + slot // SLOTS, slot % SLOTS
            corners[block, A, lane], corners[block, B, lane] = place[a], place[b]
            corners[block, P, lane] = place[p] if p >= 0 else nothing
            shapes[block, AX, lane], shapes[block, BX, lane], shapes[block, BY, lane] = ax, bx, by
            shapes[block, PX, lane], shapes[block, PY, lane] = px, py
            slot += 1
        for index in range(starts[c], starts[c + 1]):
            side = 3 * (around[index] // 3) + (around[index] % 3 + 1) % 3
            if free[side] == 0:
                block, lane = first[rank] + slot // SLOTS, slot % SLOTS
                corners[block, A, lane] = place[faces[around[index] // 3, (around[index] + 2) % 3]]
                shapes[block, AX, lane] = lengths[side]
                slot += 1
        filled[rank] = slot


@kernel
def _fill_empty(mesh, changed, starts, around, order, place, first, corners, shapes, filled):
    """Fill empty slots with given triangles that the intrinsic triangulation replaced.

    Triangles whose A is no longer a neighbour come first, so that fronts can follow given edges. Triangles with the
    farthest P come next.
    """
    touched = _touched(mesh, changed, len(order))
    ends, places = np.empty((_MOST_TRIED, 3), np.int32), np.empty((_MOST_TRIED, 5), np.float32)
    merit = np.empty(_MOST_TRIED, np.float32)
    for rank in range(len(order)):
        c = order[rank]
        slot, capacity = filled[rank], SLOTS * (first[rank + 1] - first[rank])
        if not touched[c] or slot == capacity:
            continue
        count = 0
        for index in range(starts[c], min(starts[c + 1], starts[c] + _MOST_TRIED)):
            a, b, p, ax, bx, by, px, py = _slot_of(mesh, around[index])
            behind = place[p] if p >= 0 else len(order)
            known = _find(corners, first[rank], slot, place[a], place[b], behind)
            if known == 0 or (known == 1 and p >= 0):
                ends[count, 0], ends[count, 1], ends[count, 2] = place[a], place[b], behind
                places[count, 0], places[count, 1], places[count, 2] = ax, bx, by
                places[count, 3], places[count, 4] = px, py
                merit[count] = px * px + py * py if known == 1 else np.inf
                count += 1
        for _ in range(min(count, capacity - slot)):
            best = np.argmax(merit[:count])
            block, lane = first[rank] + slot // SLOTS, slot % SLOTS
            corners[block, : P + 1, lane] = ends[best]
            shapes[block, AX:, lane] = places[best]
            merit[best] = -1.0
            slot += 1


@kernel
def _touched(mesh, changed, count):
    """Return a mask of the vertices whose given triangles may have slots that the intrinsic ones lack, (count,)."""
    faces, twins, _, _ = mesh
    touched = np.zeros(count, np.bool_)
    for face in range(len(faces)):
        for i in range(3):
            twin = twins[3 * face + i]
            if changed[face] or (twin >= 0 and changed[twin // 3]):
                touched[faces[face, i]] = True
    return touched


@borrowing
def _find(corners, block, size, a, b, p):
    """Return 2 if one of the first `size` slots has these corners, 1 if one has at least this A, otherwise 0."""
    found = 0
    for slot in range(size):
        at, lane = block + slot // SLOTS, slot % SLOTS
        if corners[at, A, lane] == a:
            found = max(found, 2 if corners[at, B, lane] == b and corners[at, P, lane] == p else 1)
    return found
