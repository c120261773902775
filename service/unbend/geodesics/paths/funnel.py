"""The shortest path in a strip of triangles, unfolded into the plane, by the funnel algorithm.

The funnel of Lee & Preparata (1984): the shortest paths from the start to both ends of a portal are the same up to the
apex, and then bend outwards to the left and to the right. The next portal moves one of these ends. Points that the path
to the new end no longer touches leave the funnel permanently, so a strip of k triangles takes O(k).
"""

from __future__ import annotations

import numpy as np

from unbend.jit import inlined, kernel


@inlined
def turn(a, b, c):
    """Return twice the signed area of the triangle (a, b, c), which is above 0 if c lies to the left of a -> b."""
    return (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x)


@inlined
def _set(point, x, y, vertex, first):
    point.x, point.y, point.vertex, point.first = x, y, vertex, first


@kernel
def _start(half_edges, leave, portal, points):
    """Place the start at the origin, and the first portal with its first (right) end on the x axis."""
    before, after = half_edges[leave].before, half_edges[leave].after
    base, along, aside = half_edges[before].length, half_edges[before].along, half_edges[before].aside
    _set(points[0], 0.0, 0.0, half_edges[leave].corner, portal - 1)
    points[0].last, points[0].parent = portal - 1, -1
    _set(points[1], base, 0.0, half_edges[after].corner, portal)
    _set(points[2], base * along, base * aside, half_edges[before].corner, portal)
    if base == 0.0:  # the start and the first end coincide
        points[2].x = half_edges[after].length


@kernel
def pull_tight(half_edges, strip, first, stop, points, ends, deque):
    """Find the shortest path through the portals `first` to `stop` - 1, of which there is at least one.

    The path starts at the corner opposite the first portal and ends at the corner opposite the last one. Return the
    index of the end in `points`. The field `parent` leads from there back to point 0, the start.

    The deque contains the funnel from its left end, at `low`, over the apex to its right end, at `high`. `step` is 1 if
    the left end moves and -1 if the right end moves, so that the same code handles both.
    """
    _start(half_edges, strip[first].exit, first, points)
    apex = stop - first + 2
    low, high = apex - 1, apex + 1
    deque[low], deque[apex], deque[high] = 2, 0, 1
    points[1].parent = points[2].parent = 0
    rx, ry, right, right_vertex = points[1].x, points[1].y, 1, points[1].vertex
    lx, ly, left, left_vertex = points[2].x, points[2].y, 2, points[2].vertex
    for portal in range(first, stop):
        ends[portal].right, ends[portal].left = right, left
        entry = half_edges[strip[portal].entry]
        along, aside = entry.along, entry.aside
        if half_edges[entry.after].corner != right_vertex:
            along = 1.0 - along
        ex, ey = lx - rx, ly - ry
        x, y, vertex = rx + along * ex + aside * ey, ry + along * ey - aside * ex, entry.corner
        point = portal - first + 3
        new = points[point]
        _set(new, x, y, vertex, portal + 1)
        step, end, other = 1, low, high
        if portal + 1 < stop and half_edges[strip[portal + 1].exit].corner != left_vertex:
            step, end, other = -1, high, low
        # Pop the points that the path to the new end no longer touches: first on the side of the new end,
        while end != apex and step * turn(points[deque[end + step]], points[deque[end]], new) <= 0.0:
            end += step
        if end == apex:  # then on the other side, where the apex advances
            while apex != other and step * turn(points[deque[apex]], points[deque[apex + step]], new) < 0.0:
                apex += step
            end = apex
        new.parent = deque[end]
        end -= step
        deque[end] = point
        if step > 0:
            points[left].last = portal
            low, left, lx, ly, left_vertex = end, point, x, y, vertex
        else:
            points[right].last = portal
            high, right, rx, ry, right_vertex = end, point, x, y, vertex
    points[right].last = stop - 1
    points[left].last = stop
    return left


@kernel
def edge_in_face(half_edges, any_half_edge, start, goal):
    """Return the half-edge between two vertices of the face of `any_half_edge`."""
    half_edge = any_half_edge
    while half_edges[half_edge].corner == start or half_edges[half_edge].corner == goal:
        half_edge = half_edges[half_edge].after
    return half_edge


@kernel
def _common_edge(half_edges, strip, points, start, goal, stop):
    """Return a half-edge of the strip between point `start` and `goal`, the next point of the path."""
    shared = max(points[start].first, points[goal].first)
    if shared <= min(points[start].last, points[goal].last):
        return strip[shared].exit
    after = points[start].last + 1  # the face before this portal contains both
    inside = strip[after].exit if after < stop else strip[stop - 1].entry
    return edge_in_face(half_edges, inside, points[start].vertex, points[goal].vertex)


@inlined
def _angle(at, one, other):
    ax, ay, bx, by = one.x - at.x, one.y - at.y, other.x - at.x, other.y - at.y
    return np.arctan2(abs(ax * by - ay * bx), ax * bx + ay * by)


@kernel
def _first_end(half_edges, half_edge, points, ends, portal):
    """Return the point at the first end of a portal's half-edge."""
    right = points[ends[portal].right]
    return right if half_edges[half_edges[half_edge].after].corner == right.vertex else points[ends[portal].left]


@kernel
def append_edge(half_edges, pieces, piece, portals, half_edge, goal):
    """Append a piece that runs along an edge to the vertex `goal`."""
    record = pieces[piece]
    record.start, record.edge, record.fresh, record.length = portals, half_edge, 1, half_edges[half_edge].length
    pieces[piece + 1].node, pieces[piece + 1].start = goal, portals


@kernel
def append_piece(half_edges, strip, points, ends, start, goal, stop, pieces, piece, portals, portal):
    """Append the straight piece between two successive points of the path; return the new end of the portals."""
    first, end = points[start].last + 1, points[goal].first
    vertex = points[goal].vertex
    if first >= end:
        half_edge = _common_edge(half_edges, strip, points, start, goal, stop)
        append_edge(half_edges, pieces, piece, portal, half_edge, vertex)
        return portal
    record = pieces[piece]
    record.start, record.edge, record.fresh = portal, -1, 1
    dx, dy = points[goal].x - points[start].x, points[goal].y - points[start].y
    record.length = np.sqrt(dx * dx + dy * dy)
    leave, enter = strip[first].exit, strip[end - 1].entry
    head = _angle(points[start], points[goal], _first_end(half_edges, leave, points, ends, first))
    tail = _angle(points[goal], points[start], _first_end(half_edges, enter, points, ends, end - 1))
    record.head = min(head, half_edges[leave].angle)
    record.tail = min(tail, half_edges[enter].angle)
    for index in range(first, end):
        portals[portal] = strip[index]
        portal += 1
    pieces[piece + 1].node, pieces[piece + 1].start = vertex, portal
    return portal
