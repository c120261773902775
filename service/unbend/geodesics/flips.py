"""The intrinsic Delaunay triangulation of a polyhedral surface, by edge flips on lengths (Fisher et al. 2007).

A flip replaces an edge by the other diagonal of its two triangles, unfolded into the plane. The surface and all
distances on it stay the same; the triangles become as round as the vertices allow.
"""

from __future__ import annotations

import numpy as np

from unbend.arrays import Floats
from unbend.geodesics.halfedges import before, following, previous_in_cycle, relink, typical_length
from unbend.geodesics.unfolding import apex
from unbend.jit import inlined, kernel
from unbend.tolerances import DELAUNAY, FLIPS, MOLLIFIED

_FLAT = 1e-300  # below every squared area; avoids a division by zero at triangles of zero area


def mollified(lengths: Floats) -> Floats:
    """Return half-edge lengths (3 m,) that satisfy every triangle inequality with a margin (Sharp & Crane 2020).

    If a triangle lacks the margin, all edges of the mesh grow by the same amount, the least that gives every triangle
    its margin. Otherwise, or if all lengths are 0, the lengths stay the same.
    """
    sides = lengths.reshape(-1, 3)
    slack = float((sides.sum(axis=1) - 2 * sides.max(axis=1)).min())
    missing = MOLLIFIED * typical_length(lengths) - slack
    return lengths + missing if missing > 0 else lengths


@inlined
def _cotangent(a, b, c):
    """Return the cotangent of the angle opposite side `a`."""
    square = (a + b + c) * (b + c - a) * (c + a - b) * (a + b - c)
    return (b * b + c * c - a * a) / np.sqrt(max(square, _FLAT))


@kernel
def flip_to_delaunay(mesh, waiting, queued, size, changed):
    """Flip edges until all are Delaunay, starting with the first `size` half-edges in `waiting`.

    Each flip queues the four edges around it. `queued` marks the half-edges in `waiting`. A flip marks its two faces in
    `changed`. An edge is not flipped if the new edge would connect a vertex to itself, because windows and stencils
    distinguish the ends of an edge by their vertices.
    """
    faces, twins, lengths, free = mesh
    left = FLIPS * len(faces)  # a limit, because rounding could flip an edge back and forth forever
    while size > 0:
        size -= 1
        half_edge = waiting[size]
        queued[half_edge] = 0
        if not free[half_edge]:
            continue
        twin = twins[half_edge]
        if faces[half_edge // 3, half_edge % 3] == faces[twin // 3, twin % 3]:
            continue
        here = _cotangent(lengths[half_edge], lengths[following(half_edge)], lengths[before(half_edge)])
        there = _cotangent(lengths[twin], lengths[following(twin)], lengths[before(twin)])
        if here + there >= -DELAUNAY or left == 0:
            continue
        left -= 1
        _flip(mesh, half_edge)
        for face in (half_edge // 3, twin // 3):
            changed[face] = 1
            for side in (0, 2):  # side 1 is the new diagonal
                outer = 3 * face + side
                if queued[outer] == 0:
                    queued[outer] = 1
                    waiting[size] = outer
                    size += 1


@kernel
def _flip(mesh, half_edge):
    """Replace the faces (C, A, B) and (P, B, A), which share the edge AB of `half_edge`, by (C, A, P) and (P, B, C)."""
    faces, twins, lengths, free = mesh
    twin = twins[half_edge]
    f, g = half_edge // 3, twin // 3
    c, a, b = faces[f, half_edge % 3], faces[f, following(half_edge) % 3], faces[f, before(half_edge) % 3]
    p = faces[g, twin % 3]
    old = (following(half_edge), before(half_edge), following(twin), before(twin))  # BC, CA, AP, PB
    new = (3 * g, 3 * f + 2, 3 * f, 3 * g + 2)
    sides = (lengths[old[0]], lengths[old[1]], lengths[old[2]], lengths[old[3]])
    were_free = (free[old[0]], free[old[1]], free[old[2]], free[old[3]])
    nexts = (twins[old[0]], twins[old[1]], twins[old[2]], twins[old[3]])
    previous = (
        previous_in_cycle(twins, old[0]), previous_in_cycle(twins, old[1]),
        previous_in_cycle(twins, old[2]), previous_in_cycle(twins, old[3]),
    )  # fmt: skip
    cx, cy = apex(sides[1], sides[0], lengths[half_edge])
    px, py = apex(sides[2], sides[3], lengths[half_edge])
    diagonal = np.sqrt((cx - px) ** 2 + (cy + py) ** 2)
    faces[f, 0], faces[f, 1], faces[f, 2] = c, a, p
    faces[g, 0], faces[g, 1], faces[g, 2] = p, b, c
    for k in range(4):
        lengths[new[k]], free[new[k]] = sides[k], were_free[k]
    for middle in (3 * f + 1, 3 * g + 1):
        lengths[middle], free[middle] = diagonal, 1
    relink(twins, old, new, nexts, previous)
    twins[3 * f + 1], twins[3 * g + 1] = 3 * g + 1, 3 * f + 1
