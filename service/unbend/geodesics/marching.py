"""The marching kernel: one source, one sweep over the vertices in the order of their distance."""

from __future__ import annotations

import numpy as np

from unbend.geodesics.heap import pop, push_or_decrease
from unbend.jit import inlined, kernel
from unbend.tolerances import START_DISC_EDGES


@inlined
def _planar(ua, ub, c, x, y):
    """Distance of C from a plane front through A and B (Kimmel & Sethian 1998), inf if it comes from outside.

    The front's unit gradient g has g . (B - A) = ub - ua; the ray back from C must meet the segment AB.
    """
    gx = (ub - ua) / c
    if not -1.0 < gx < 1.0:
        return np.inf
    gy = np.sqrt(1.0 - gx * gx)
    foot = x * gy - y * gx
    if foot < 0.0 or foot > c * gy:
        return np.inf
    return ua + gx * x + gy * y


@inlined
def _spherical(ua, ub, c, x, y):
    """Distance of C from the virtual point source that is ua from A and ub from B (Novotni & Klein 2002).

    The source is unfolded to (sx, -sy) below AB; the segment from it to C must meet AB, otherwise inf.
    """
    sx = (ua * ua - ub * ub + c * c) / (2.0 * c)
    sy = np.sqrt(max(0.0, ua * ua - sx * sx))
    foot = sx * y + x * sy
    height = y + sy
    if foot < 0.0 or foot > c * height:
        return np.inf
    return np.sqrt((x - sx) * (x - sx) + height * height)


@inlined
def _mean_edge(offsets, entries, vertex):
    total = 0.0
    for index in range(offsets[vertex], offsets[vertex + 1]):
        total += np.sqrt(entries[index].x ** 2 + entries[index].y ** 2)
    return total / max(1, offsets[vertex + 1] - offsets[vertex])


@kernel
def march(offsets, entries, source, spherical, distance, owner, label, keys, items, position):
    """March from `source` and lower `distance` wherever the front improves it; it stops where it does not.

    With `distance` all inf this is plain fast marching. With the distances to earlier sources it visits only
    the new source's Voronoi cell, which is what makes farthest point sampling cheap. `owner` holds the label of
    the front that accepted each vertex: two distances are combined only where one front gave both.

    Near its source a front is nothing like a plane, and what the planar update errs there it carries everywhere;
    so both updates start with a small disc of spherical ones, which unfold it exactly where it is flat.
    """
    disc = START_DISC_EDGES * _mean_edge(offsets, entries, source)
    distance[source] = 0.0
    size = push_or_decrease(keys, items, position, 0, source, 0.0)
    while size > 0:
        a, size = pop(keys, items, position, size)
        owner[a] = label
        ua = distance[a]
        for index in range(offsets[a], offsets[a + 1]):
            entry = entries[index]
            target = entry.target
            if owner[target] == label or distance[target] <= ua:
                continue
            x, y, c = entry.x, entry.y, entry.c
            candidate = np.inf
            if owner[entry.other] == label and c > 0.0:
                ub = distance[entry.other]
                candidate = _spherical(ua, ub, c, x, y) if spherical or ua <= disc else _planar(ua, ub, c, x, y)
            if candidate == np.inf:  # the way along the edge; one through the triangle is never longer
                candidate = ua + np.sqrt(x * x + y * y)
            if candidate < distance[target]:
                distance[target] = candidate
                size = push_or_decrease(keys, items, position, size, target, candidate)


@kernel
def march_rows(offsets, entries, sources, columns, spherical, rows, distance, owner, keys, items, position):
    """March from each of `sources` in turn and keep the distances at `columns` in `rows` (k, len(columns))."""
    for row in range(len(sources)):
        distance[:] = np.inf
        owner[:] = -1
        march(offsets, entries, sources[row], spherical, distance, owner, 0, keys, items, position)
        for column in range(len(columns)):
            rows[row, column] = distance[columns[column]]
