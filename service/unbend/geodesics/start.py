"""The exact start of a front: straight lines from the source, over the triangles around it.

A front is rounder near its source than any update allows for, and what is lost there is carried everywhere: marching
from a point converges as h^0.67 where it starts with the point alone. So the triangles around the source are unfolded
one after the other, window by window (Mitchell, Mount & Papadimitriou 1987), and every vertex that the source sees
through them gets its distance in a straight line.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from unbend.geodesics.stencils import AX, BX, BY, SLOTS, A, B
from unbend.geodesics.unfolding import apex_beyond
from unbend.jit import kernel
from unbend.tolerances import START_DEPTH

_SHORT: Final = 1e-3  # an edge so short, as seen from the source, says nothing of directions in single precision
_WINDOWS: Final = 4096  # those of a source with more triangles are left to marching


def start_arrays(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return what `start_front` works on for `count` vertices: seeds, the corners of windows, their shapes."""
    return np.empty(count, np.int32), np.empty((_WINDOWS, 4), np.int32), np.empty((_WINDOWS, 8))


@kernel
def start_front(stencils, source, value, start):
    """Set `value` in straight lines from `source`, list the vertices set in `seeds`, return their number.

    A window is an edge (A, B) laid into the plane of the source, B counter-clockwise of A, with the rays between
    which the source sees it. It is passed on over every other triangle at the edge.
    """
    first, corners, shapes = stencils
    seeds, windows, edges = start
    nothing = len(first) - 1
    value[source] = 0.0
    seeds[0] = source
    count = 1
    size = 0
    opened = 0  # in all: at an edge of many triangles windows would multiply without end
    for home in range(first[source], first[source + 1]):
        for lane in range(SLOTS):
            a, b = corners[home, A, lane], corners[home, B, lane]
            if a == nothing:
                continue
            ax, bx, by = shapes[home, AX, lane], shapes[home, BX, lane], shapes[home, BY, lane]
            if ax < value[a]:  # every neighbour is some slot's A
                if value[a] == np.inf:
                    seeds[count] = a
                    count += 1
                value[a] = ax
            if b != nothing and by > 0.0 and opened < len(windows):
                windows[size, 0], windows[size, 1], windows[size, 2], windows[size, 3] = a, b, source, 0
                edges[size, 0], edges[size, 1], edges[size, 2], edges[size, 3] = ax, 0.0, bx, by
                edges[size, 4], edges[size, 5], edges[size, 6], edges[size, 7] = ax, 0.0, bx, by
                size += 1
                opened += 1
    while size > 0:
        size -= 1
        a, b, behind, depth = windows[size, 0], windows[size, 1], windows[size, 2], windows[size, 3]
        ax, ay, bx, by = edges[size, 0], edges[size, 1], edges[size, 2], edges[size, 3]
        right_x, right_y, left_x, left_y = edges[size, 4], edges[size, 5], edges[size, 6], edges[size, 7]
        base = np.sqrt((bx - ax) ** 2 + (by - ay) ** 2)
        if base <= _SHORT * np.sqrt(ax * ax + ay * ay):
            continue
        for block in range(first[a], first[a + 1]):
            for lane in range(SLOTS):
                near, far = corners[block, A, lane], corners[block, B, lane]
                if (near != b and far != b) or near == behind or far == behind:
                    continue
                d, x, y = far, np.float64(shapes[block, BX, lane]), np.float64(shapes[block, BY, lane])
                if far == b:
                    turn = shapes[block, AX, lane] / np.sqrt(x * x + y * y)
                    d, x, y = near, turn * x, turn * y
                if d == nothing:
                    continue
                dx, dy = apex_beyond(ax, ay, bx, by, x, y, base)
                left_of_right = right_x * dy - right_y * dx >= 0.0
                right_of_left = dx * left_y - dy * left_x >= 0.0
                if left_of_right and right_of_left:
                    straight = np.float32(np.sqrt(dx * dx + dy * dy))
                    if straight < value[d]:
                        if value[d] == np.inf:
                            seeds[count] = d
                            count += 1
                        value[d] = straight
                if depth == START_DEPTH or opened + 2 > len(windows):
                    continue
                if left_of_right:  # some of the edge from A to D is seen
                    windows[size, 0], windows[size, 1], windows[size, 2], windows[size, 3] = a, d, b, depth + 1
                    edges[size, 0], edges[size, 1], edges[size, 2], edges[size, 3] = ax, ay, dx, dy
                    edges[size, 4], edges[size, 5] = right_x, right_y
                    edges[size, 6], edges[size, 7] = (dx, dy) if right_of_left else (left_x, left_y)
                    size += 1
                    opened += 1
                if right_of_left:
                    windows[size, 0], windows[size, 1], windows[size, 2], windows[size, 3] = d, b, a, depth + 1
                    edges[size, 0], edges[size, 1], edges[size, 2], edges[size, 3] = dx, dy, bx, by
                    edges[size, 4], edges[size, 5] = (dx, dy) if left_of_right else (right_x, right_y)
                    edges[size, 6], edges[size, 7] = left_x, left_y
                    size += 1
                    opened += 1
    return count
