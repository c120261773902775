"""Exact distances of points from a triangulated surface."""

from __future__ import annotations

import numpy as np

from unbend.arrays import Floats, Indices, Ints
from unbend.jit import inlined, kernel
from unbend.mesh.boxes import LEAF, box_distance, build_boxes, push_children
from unbend.tolerances import DEGENERATE_HEIGHT


def largest_distance(points: Floats, vertices: Floats, faces: Ints, near: Indices) -> float:
    """Return the largest distance of any of `points` (k, 3) from the triangles `faces` (m, 3) of `vertices`.

    `near` (k,) has for each point a vertex that may be near, -1 for none. The distance from the faces at that vertex is
    an upper bound for the point. Points with the largest bounds come first. A later point needs no search if its bound
    is below the largest distance found so far.
    """
    low = vertices.min(axis=0)
    scale = float((vertices.max(axis=0) - low).max()) or 1.0
    points, corners = (points - low) / scale, ((vertices - low) / scale)[faces]
    around = np.argsort(faces.ravel(), kind="stable") // 3
    offsets = np.append(0, np.cumsum(np.bincount(faces.ravel(), minlength=len(vertices))))
    bounds = _fan_distances(points, corners, near, around, offsets)
    order = np.argsort(-bounds)
    tree = build_boxes(corners.min(axis=1), corners.max(axis=1))
    squared = _farthest(points[order], bounds[order], corners[tree.order], tree.lower, tree.upper)
    return scale * float(np.sqrt(squared))


@inlined
def _cross(a0: float, a1: float, a2: float, b0: float, b1: float, b2: float) -> tuple[float, float, float]:
    return a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0


@inlined
def _triple(n0: float, n1: float, n2: float, a0: float, a1: float, a2: float, b0: float, b1: float, b2: float) -> float:
    return n0 * (a1 * b2 - a2 * b1) + n1 * (a2 * b0 - a0 * b2) + n2 * (a0 * b1 - a1 * b0)


@inlined
def _segment_distance(a0: float, a1: float, a2: float, b0: float, b1: float, b2: float) -> float:
    """Return the squared distance of the origin from a segment."""
    e0, e1, e2 = b0 - a0, b1 - a1, b2 - a2
    square = e0 * e0 + e1 * e1 + e2 * e2
    along = min(1.0, max(0.0, -(a0 * e0 + a1 * e1 + a2 * e2) / square)) if square > 0.0 else 0.0
    return (a0 + along * e0) ** 2 + (a1 + along * e1) ** 2 + (a2 + along * e2) ** 2


@kernel
def triangle_distance(corners: Floats, face: int, x: float, y: float, z: float) -> float:
    """Return the squared distance of a point from a triangle, which may be degenerate."""
    a0, a1, a2 = corners[face, 0, 0] - x, corners[face, 0, 1] - y, corners[face, 0, 2] - z
    b0, b1, b2 = corners[face, 1, 0] - x, corners[face, 1, 1] - y, corners[face, 1, 2] - z
    c0, c1, c2 = corners[face, 2, 0] - x, corners[face, 2, 1] - y, corners[face, 2, 2] - z
    ab = _segment_distance(a0, a1, a2, b0, b1, b2)
    bc = _segment_distance(b0, b1, b2, c0, c1, c2)
    ca = _segment_distance(c0, c1, c2, a0, a1, a2)
    n0, n1, n2 = _cross(b0 - a0, b1 - a1, b2 - a2, c0 - a0, c1 - a1, c2 - a2)
    square = n0 * n0 + n1 * n1 + n2 * n2
    longest = max(
        (b0 - a0) ** 2 + (b1 - a1) ** 2 + (b2 - a2) ** 2,
        (c0 - b0) ** 2 + (c1 - b1) ** 2 + (c2 - b2) ** 2,
        (a0 - c0) ** 2 + (a1 - c1) ** 2 + (a2 - c2) ** 2,
    )
    nearest = min(ab, bc, ca)
    if square <= (DEGENERATE_HEIGHT * longest) ** 2:
        return nearest  # no usable normal; the nearest point is on an edge
    if (
        _triple(n0, n1, n2, a0, a1, a2, b0, b1, b2) >= 0.0
        and _triple(n0, n1, n2, b0, b1, b2, c0, c1, c2) >= 0.0
        and _triple(n0, n1, n2, c0, c1, c2, a0, a1, a2) >= 0.0
    ):
        height = n0 * a0 + n1 * a1 + n2 * a2
        nearest = min(nearest, height * height / square)
    return nearest


@kernel
def _fan_distances(points: Floats, corners: Floats, near: Indices, around: Indices, offsets: Indices) -> Floats:
    """Return the squared distance of each point from the faces at its vertex in `near`, infinite if that is -1."""
    distances = np.full(len(points), np.inf)
    for i in range(len(points)):
        if near[i] >= 0:
            x, y, z = points[i]
            for place in range(offsets[near[i]], offsets[near[i] + 1]):
                distances[i] = min(distances[i], triangle_distance(corners, around[place], x, y, z))
    return distances


@kernel
def _farthest(points: Floats, bounds: Floats, corners: Floats, lower: Floats, upper: Floats) -> float:
    """Return the largest squared distance of a point from the nearest triangle; `bounds` are upper bounds."""
    stack = np.empty(64, np.int64)
    leaves = len(lower) // 2
    farthest = 0.0
    for i in range(len(points)):
        x, y, z = points[i]
        nearest = bounds[i]
        stack[0], top = 1, 0
        while top >= 0 and nearest > farthest:  # stop once the point cannot be the farthest
            node = stack[top]
            top -= 1
            if box_distance(lower, upper, node, x, y, z) >= nearest:
                continue
            if node < leaves:
                top = push_children(stack, top, node, lower, upper, x, y, z)
                continue
            for j in range(LEAF * (node - leaves), min(LEAF * (node - leaves + 1), len(corners))):
                nearest = min(nearest, triangle_distance(corners, j, x, y, z))
        farthest = max(farthest, nearest)
    return farthest
