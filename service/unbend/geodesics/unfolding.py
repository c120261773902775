"""Unfolding of triangles into the plane, one after the other over their shared edges."""

from __future__ import annotations

import numpy as np

from unbend.jit import borrowing, inlined, kernel
from unbend.tolerances import DEGENERATE_BASE, UNFOLDING_STEPS


@inlined
def apex(from_a, from_b, base):
    """Place a triangle's third corner over its base from (0, 0) to (base, 0): the law of cosines."""
    if base <= 0.0:
        return 0.0, from_a
    x = (from_a * from_a - from_b * from_b + base * base) / (2.0 * base)
    return x, np.sqrt(max(0.0, from_a * from_a - x * x))


@inlined
def apex_beyond(ax, ay, bx, by, x, y, base):
    """Place an apex on the right of the base A -> B, at x along the base from A and at the distance y from it."""
    ex, ey = (bx - ax) / base, (by - ay) / base
    return ax + x * ex + y * ey, ay + x * ey - y * ex


@inlined
def angle(beside, other, opposite):
    """Return the angle between two sides of a triangle: the law of cosines."""
    cosine = (beside * beside + other * other - opposite * opposite) / (2.0 * beside * other)
    return np.arccos(min(1.0, max(-1.0, cosine)))


@kernel
def half_edge_lengths(vertices, faces):
    """Return the length of each half-edge 3 f + i, which lies opposite corner i of face f, (3 m,)."""
    lengths = np.empty(3 * len(faces))
    for half_edge in range(len(lengths)):
        face, corner = half_edge // 3, half_edge % 3
        a, b = faces[face, (corner + 1) % 3], faces[face, (corner + 2) % 3]
        dx = vertices[a, 0] - vertices[b, 0]
        dy = vertices[a, 1] - vertices[b, 1]
        dz = vertices[a, 2] - vertices[b, 2]
        lengths[half_edge] = np.sqrt(dx * dx + dy * dy + dz * dz)
    return lengths


@borrowing
def vertex_behind(lengths, faces, twins, half_edge, ax, bx, by):
    """Unfold over `half_edge`, away from the corner C opposite it, to the first vertex P that is visible from C.

    C is at the origin, the ends of the edge are at A = (ax, 0) and B = (bx, by), by > 0. P must lie between the rays
    from C to A and B. If C's angle is obtuse, CP must also make an acute angle with both rays (Kimmel & Sethian 1998,
    section 4.2).

    Returns
    -------
    (P, x, y)
        P is -1 if the search ends at a boundary, at a triangle with a base of zero length, or at the limit of steps.
    """
    ay = 0.0
    right_x, right_y, left_x, left_y = ax, ay, bx, by
    if bx < 0.0:  # the rays at right angles to CB and CA
        right_x, right_y, left_x, left_y = by, -bx, 0.0, ax
    face, corner = half_edge // 3, half_edge % 3
    a = faces[face, (corner + 1) % 3]
    for _ in range(UNFOLDING_STEPS):
        twin = twins[half_edge]
        base = np.sqrt((bx - ax) ** 2 + (by - ay) ** 2)
        if twin < 0:
            break
        face, corner = twin // 3, twin % 3
        p = faces[face, corner]
        following, before = 3 * face + (corner + 1) % 3, 3 * face + (corner + 2) % 3
        reversed_ = faces[face, (corner + 1) % 3] == a  # the two triangles have opposite orientations
        beside_a, beside_b = (before, following) if reversed_ else (following, before)
        if base <= DEGENERATE_BASE * (lengths[beside_a] + lengths[beside_b]):
            break
        x, y = apex(lengths[beside_a], lengths[beside_b], base)
        px, py = apex_beyond(ax, ay, bx, by, x, y, base)
        if right_x * py - right_y * px < 0.0:
            half_edge = beside_b
            ax, ay, a = px, py, p
        elif px * left_y - py * left_x < 0.0:
            half_edge = beside_a
            bx, by = px, py
        else:
            return p, px, py
    return -1, 0.0, 0.0
