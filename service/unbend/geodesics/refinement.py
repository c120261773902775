"""Intrinsic Delaunay refinement: Steiner points at the circumcentres of thin triangles (Chew 1993; Sharp et al. 2019).

Where vertices are few and far apart, as on the faces of CAD models, even Delaunay triangles are thin, and a front that
crosses them has values at too few vertices. New vertices on the surface make the triangles rounder. Their places are
known only by their distances from other vertices, and only marching uses them.
"""

from __future__ import annotations

import numpy as np

from unbend.geodesics.flips import flip_to_delaunay
from unbend.geodesics.halfedges import before, following, previous_in_cycle, relink
from unbend.geodesics.unfolding import apex, apex_beyond
from unbend.jit import inlined, kernel
from unbend.tolerances import HOPELESS, REFINEMENT_STEPS

_LOST = -1  # in place of a face: the circumcentre was not found, or nothing was inserted


@inlined
def largest_cosine(a, b, c):
    """Return the cosine of the smallest angle of a triangle with sides a, b and c."""
    return max(
        (b * b + c * c - a * a) / (2.0 * b * c),
        (c * c + a * a - b * b) / (2.0 * c * a),
        (a * a + b * b - c * c) / (2.0 * a * b),
    )


@kernel
def refine(mesh, face_count, vertex_count, most, bound, narrow, work, changed):
    """Insert vertices until no smallest angle has a cosine above `bound`, there are `most` vertices, or `mesh` is full.

    A thin triangle stays if its smallest angle is at a `narrow` vertex, if its shortest side is far shorter than its
    longest, or if its circumcentre cannot be inserted. Return the numbers of faces and vertices.
    """
    faces, _, lengths, _ = mesh
    waiting, queued, todo = work
    left = 0
    for face in range(face_count - 1, -1, -1):
        if largest_cosine(lengths[3 * face], lengths[3 * face + 1], lengths[3 * face + 2]) > bound:
            todo[left] = face
            left += 1
    while left > 0 and vertex_count < most and face_count + 2 <= len(faces):
        left -= 1
        face = todo[left]
        a, b, c = lengths[3 * face], lengths[3 * face + 1], lengths[3 * face + 2]
        shortest = min(a, b, c)
        sharp = 0 if shortest == a else (1 if shortest == b else 2)
        if not largest_cosine(a, b, c) > bound or narrow[faces[face, sharp]] or shortest < HOPELESS * max(a, b, c):
            continue
        first, second = _insert_circumcentre(mesh, face, shortest, face_count, vertex_count)
        if first < 0:
            continue
        size = 0
        for new in (first, face_count, second):
            changed[new] = 1
            for side in range(3 * new, 3 * new + 3):
                if queued[side] == 0:
                    queued[side] = 1
                    waiting[size] = side
                    size += 1
        face_count += 1 if second == first else 2
        flip_to_delaunay(mesh, waiting, queued, size, changed)
        left = _list_around(mesh, _corner_of(faces, first, vertex_count), vertex_count, todo, left)
        vertex_count += 1
    return face_count, vertex_count


@kernel
def _corner_of(faces, face, vertex):
    for i in range(3):
        if faces[face, i] == vertex:
            return 3 * face + i
    return -1


@kernel
def _list_around(mesh, corner, vertex, todo, left):
    """Append the faces around `vertex` to `todo`, starting at its `corner`; return the new size of `todo`.

    The loop turns one way. If it meets an edge that is not free, it starts again at `corner` and turns the other way.
    """
    faces, twins, _, free = mesh
    if corner < 0:
        return left
    for turn in (1, 2):
        at = corner
        while left < len(todo):
            todo[left] = at // 3
            left += 1
            side = 3 * (at // 3) + (at % 3 + turn) % 3
            if not free[side]:
                break
            twin = twins[side]
            at = 3 * (twin // 3) + (twin % 3 + turn) % 3
            if at == corner or faces[at // 3, at % 3] != vertex:
                return left
    return left


@kernel
def _insert_circumcentre(mesh, face, shortest, new_face, new_vertex):
    """Insert the circumcentre of `face`, or halve the boundary edge that lies in front of the circumcentre.

    Nothing is inserted if an edge would be shorter than `shortest`. No vertex is nearer to the circumcentre of a
    Delaunay triangle than the triangle's corners, so only rounding makes such edges at circumcentres. Return the face
    that was split, and the new face after `new_face`. If an edge was halved, there is no second new face, and both
    values are the split face. If nothing was inserted, both are -1.
    """
    _, twins, lengths, _ = mesh
    at, half_edge, d0, d1, d2 = _walk(mesh, face)
    if half_edge >= 0:
        middle = _median(lengths[half_edge], lengths[before(half_edge)], lengths[following(half_edge)])
        if twins[half_edge] >= 0 or min(0.5 * lengths[half_edge], middle) < shortest:  # only boundary edges are halved
            return _LOST, _LOST
        _halve_boundary(mesh, half_edge, new_face, new_vertex)
        return half_edge // 3, half_edge // 3
    if at < 0 or min(d0, d1, d2) < shortest:
        return _LOST, _LOST
    _split(mesh, at, new_face, new_vertex, d0, d1, d2)
    return at, new_face + 1


@inlined
def _median(base, from_a, from_b):
    """Return the length from a triangle's third corner to the middle of its base."""
    return 0.5 * np.sqrt(max(0.0, 2.0 * (from_a * from_a + from_b * from_b) - base * base))


@kernel
def _walk(mesh, face):
    """Walk in a straight line from the middle of `face` to its circumcentre.

    Return a face, a half-edge and three distances. If a face contains the circumcentre, return that face, -1 and the
    distances from the circumcentre to its corners. If the walk meets an edge that cannot be crossed, return -1, that
    half-edge and zeros. If the walk fails, return -1, -1 and zeros.
    """
    _, twins, lengths, free = mesh
    x, y = np.zeros(3), np.zeros(3)
    x[1] = lengths[3 * face + 2]
    x[2], y[2] = apex(lengths[3 * face + 1], lengths[3 * face], x[1])
    if not y[2] > 0.0:
        return _LOST, -1, 0.0, 0.0, 0.0
    from_x, from_y = (x[1] + x[2]) / 3.0, y[2] / 3.0
    to_x, to_y = 0.5 * x[1], 0.5 * (x[2] * x[2] + y[2] * y[2] - x[1] * x[2]) / y[2]
    came = -1
    for _ in range(REFINEMENT_STEPS):
        leaves, soonest = -1, np.inf
        for i in range(3):
            if 3 * face + i == came:
                continue
            a, b = (i + 1) % 3, (i + 2) % 3
            ex, ey = x[b] - x[a], y[b] - y[a]
            beyond = ex * (to_y - y[a]) - ey * (to_x - x[a])
            inside = ex * (from_y - y[a]) - ey * (from_x - x[a])
            if beyond < 0.0 and inside / (inside - beyond) < soonest:
                leaves, soonest = i, inside / (inside - beyond)
        if leaves < 0:
            d = np.sqrt((x - to_x) ** 2 + (y - to_y) ** 2)
            return face, -1, d[0], d[1], d[2]
        half_edge = 3 * face + leaves
        if not free[half_edge]:
            return _LOST, half_edge, 0.0, 0.0, 0.0
        came = twins[half_edge]
        a, b = (leaves + 1) % 3, (leaves + 2) % 3
        ax, ay, bx, by = x[a], y[a], x[b], y[b]
        face, j = came // 3, came % 3
        near_b, near_a = (j + 1) % 3, (j + 2) % 3
        base = np.sqrt((bx - ax) ** 2 + (by - ay) ** 2)
        px, py = apex(lengths[3 * face + near_b], lengths[3 * face + near_a], base)
        x[near_a], y[near_a], x[near_b], y[near_b] = ax, ay, bx, by
        x[j], y[j] = apex_beyond(ax, ay, bx, by, px, py, base)
    return _LOST, -1, 0.0, 0.0, 0.0


@kernel
def _split(mesh, face, new_face, vertex, d0, d1, d2):
    """Split `face` (A, B, C) into (A, B, V), which keeps its number, `new_face` (B, C, V) and the next (C, A, V)."""
    faces, twins, lengths, free = mesh
    g, h = new_face, new_face + 1
    a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
    old = (3 * face, 3 * face + 1, 3 * face + 2)
    new = (3 * g + 2, 3 * h + 2, 3 * face + 2)
    sides = (lengths[old[0]], lengths[old[1]], lengths[old[2]])
    were_free = (free[old[0]], free[old[1]], free[old[2]])
    nexts = (twins[old[0]], twins[old[1]], twins[old[2]])
    previous = (
        previous_in_cycle(twins, old[0]), previous_in_cycle(twins, old[1]), previous_in_cycle(twins, old[2]),
    )  # fmt: skip
    faces[face, 0], faces[face, 1], faces[face, 2] = a, b, vertex
    faces[g, 0], faces[g, 1], faces[g, 2] = b, c, vertex
    faces[h, 0], faces[h, 1], faces[h, 2] = c, a, vertex
    for k in range(3):
        lengths[new[k]], free[new[k]] = sides[k], were_free[k]
    relink(twins, old, new, nexts, previous)
    for one, other, length in ((3 * face, 3 * g + 1, d1), (3 * g, 3 * h + 1, d2), (3 * h, 3 * face + 1, d0)):
        twins[one], twins[other] = other, one
        lengths[one] = lengths[other] = length
        free[one] = free[other] = 1


@kernel
def _halve_boundary(mesh, half_edge, new_face, vertex):
    """Split the face (C, A, B) at the middle V of its boundary edge AB into (C, A, V) and `new_face` (C, V, B)."""
    faces, twins, lengths, free = mesh
    f, i = half_edge // 3, half_edge % 3
    c, a, b = faces[f, i], faces[f, (i + 1) % 3], faces[f, (i + 2) % 3]
    old = (3 * f + (i + 1) % 3, 3 * f + (i + 2) % 3)  # BC, CA
    new = (3 * new_face + 1, 3 * f + 2)
    sides, half = (lengths[old[0]], lengths[old[1]]), 0.5 * lengths[half_edge]
    were_free = (free[old[0]], free[old[1]])
    nexts = (twins[old[0]], twins[old[1]])
    previous = (previous_in_cycle(twins, old[0]), previous_in_cycle(twins, old[1]))
    middle = _median(lengths[half_edge], sides[1], sides[0])
    faces[f, 0], faces[f, 1], faces[f, 2] = c, a, vertex
    faces[new_face, 0], faces[new_face, 1], faces[new_face, 2] = c, vertex, b
    for k in range(2):
        lengths[new[k]], free[new[k]] = sides[k], were_free[k]
    relink(twins, old, new, nexts, previous)
    for outer in (3 * f, 3 * new_face):
        twins[outer], lengths[outer], free[outer] = -1, half, 0
    one, other = 3 * f + 1, 3 * new_face + 2
    twins[one], twins[other] = other, one
    lengths[one] = lengths[other] = middle
    free[one] = free[other] = 1
