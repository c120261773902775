"""Descent of a distance field, from a vertex to the field's source, across the interiors of triangles.

On each edge the field defines a virtual point source: the point in the plane behind the edge that has the field's
distances from both ends (Novotni & Klein 2002, the model of spherical marching). The walk goes straight to the best
virtual source visible from its triangle, so the walk is exact where the field is. The walk only has to pass each
obstacle on the correct side, because `pull_tight` corrects errors within a strip.
"""

from __future__ import annotations

import numpy as np

from unbend.geodesics.paths.funnel import append_edge
from unbend.jit import inlined, kernel

_MAX_STALLED = 32  # successive steps that may come no nearer to the source, because the field is not exact


@inlined
def _virtual_source(ua, ub, c):
    """Return the point above the x axis at the distance ua from (0, 0) and ub from (c, 0)."""
    x = (ua * ua - ub * ub + c * c) / (2.0 * c)
    return x, np.sqrt(max(0.0, ua * ua - x * x))


@inlined
def _look(ua, ub, c, x, y):
    """View the virtual source of the edge from (0, 0) to (c, 0) from the point (x, -y).

    Return the distance to the source, the x at which the line of sight crosses the edge, and the distance from that
    crossing to the source. The first is inf if the source is not visible.
    """
    sx, sy = _virtual_source(ua, ub, c)
    crossing = (sx * y + x * sy) / (y + sy)
    if not (0.0 < crossing < c):
        return np.inf, 0.0, 0.0
    distance = np.sqrt((x - sx) * (x - sx) + (y + sy) * (y + sy))
    return distance, crossing, distance * sy / (y + sy)


@kernel
def _leave(half_edges, offsets, corners, field, shrink, vertex, source):
    """Choose how to leave `vertex`.

    Return a half-edge, and the share of its length at which to cross it, or -1 to walk along it.
    """
    best, chosen, crossing = np.inf, np.int64(-1), -1.0
    for index in range(offsets[vertex], offsets[vertex + 1]):
        opposite = half_edges[corners[index]]
        before, after = opposite.before, opposite.after
        a, b = half_edges[after].corner, half_edges[before].corner
        if a == source:
            return before, -1.0
        if b == source:
            return after, -1.0
        ua, ub = field[a] * shrink, field[b] * shrink
        if field[a] < field[vertex] and ua + half_edges[before].length < best:
            best, chosen, crossing = ua + half_edges[before].length, before, -1.0
        if field[b] < field[vertex] and ub + half_edges[after].length < best:
            best, chosen, crossing = ub + half_edges[after].length, after, -1.0
        c = opposite.length
        if opposite.twin >= 0:
            seen, at, _ = _look(ua, ub, c, c * opposite.along, c * opposite.aside)
            if seen < best:
                best, chosen, crossing = seen, corners[index], at / c
    return chosen, crossing


@kernel
def _other_end(half_edges, half_edge, vertex):
    one = half_edges[half_edges[half_edge].after].corner
    return half_edges[half_edges[half_edge].before].corner if one == vertex else one


@kernel
def _cheapest_edge(half_edges, offsets, corners, field, shrink, vertex):
    """Return the half-edge at `vertex` whose other end gives the least distance to the source, and that distance."""
    best, chosen = np.inf, np.int64(-1)
    for index in range(offsets[vertex], offsets[vertex + 1]):
        opposite = half_edges[corners[index]]
        for side in range(2):
            edge = opposite.after if side else opposite.before
            through = field[_other_end(half_edges, edge, vertex)] * shrink + half_edges[edge].length
            if through < best:
                best, chosen = through, edge
    return chosen, best


@kernel
def _enter(half_edges, field, half_edge):
    """Return the half-edge that enters the next face; of several, the one whose corner is nearest to the source."""
    chosen = entry = half_edges[half_edge].twin
    while half_edges[entry].twin != half_edge:
        entry = half_edges[entry].twin
        if field[half_edges[entry].corner] < field[half_edges[chosen].corner]:
            chosen = entry
    return chosen


@inlined
def _cross_face(portal, before, after, ua, ub, uc, at):
    """Cross the face entered through half-edge `portal`, at the share `at` of its length.

    `before` and `after` are the face's other half-edges. The field is ua and ub at the portal's ends, and uc at the
    opposite corner. Return the half-edge to leave by, the share of its length at which to cross it, the distance
    from there to the source, and a vertex. If the half-edge is -1, the walk goes to that vertex.
    """
    base, along, aside = portal.length, portal.along, portal.aside
    leave, share, value, goal = -1, 0.0, 0.0, portal.corner
    best = uc + base * np.sqrt((along - at) * (along - at) + aside * aside)
    if before.twin >= 0:  # the edge from the portal's first end to the opposite corner
        scale = at * base * base / before.length
        seen, crossing, there = _look(ua, uc, before.length, scale * along, scale * aside)
        if seen < best:
            best, leave, share, value = seen, portal.before, 1.0 - crossing / before.length, there
    if after.twin >= 0:  # the edge from the second end
        scale = (1.0 - at) * base * base / after.length
        seen, crossing, there = _look(ub, uc, after.length, scale * (1.0 - along), scale * aside)
        if seen < best:
            best, leave, share, value = seen, portal.after, crossing / after.length, there
    if ua + at * base < best:
        best, leave, goal = ua + at * base, -1, after.corner
    if ub + (1.0 - at) * base < best:
        leave, goal = -1, before.corner
    return leave, share, value, goal


@kernel
def _walk(half_edges, field, shrink, source, portals, portal, leave, at):
    """Walk through half-edge `leave` until a vertex; return that vertex and the end of the portals.

    The vertex is -1 if the array of portals is full.
    """
    nearest, stalled = np.inf, 0
    while portal < len(portals):
        entry = _enter(half_edges, field, leave)
        portals[portal].exit, portals[portal].entry = leave, entry
        portal += 1
        if half_edges[entry].corner == source:
            return source, portal
        before, after = half_edges[half_edges[entry].before], half_edges[half_edges[entry].after]
        if after.corner != half_edges[half_edges[leave].after].corner:
            at = 1.0 - at
        ua, ub, uc = (
            field[after.corner] * shrink,
            field[before.corner] * shrink,
            field[half_edges[entry].corner] * shrink,
        )
        leave, at, value, goal = _cross_face(half_edges[entry], before, after, ua, ub, uc, at)
        if leave < 0 or stalled == _MAX_STALLED:
            return goal, portal
        stalled = 0 if value < nearest else stalled + 1
        nearest = min(value, nearest)
    return -1, portal


@kernel
def descend(half_edges, offsets, corners, field, shrink, source, target, pieces, portals):
    """Walk from `target` down to `source`; fill the path and return its number of pieces, -1 if no path is found.

    A local minimum is an error of the field. The walk leaves a local minimum by the cheapest edge, and raises the field
    there to the cost of that edge, so that it does not fall into the same minimum again (Korf 1990, learning real-time
    A*).
    """
    # A literal 0 has a type of its own, for which Numba would compile every callee again.
    vertex, piece, portal = target, np.int64(0), np.int64(0)
    pieces[0].node, pieces[0].start = target, 0
    for _ in range(len(pieces) - 2):
        if vertex == source:
            return piece
        chosen, at = _leave(half_edges, offsets, corners, field, shrink, vertex, source)
        goal, end = np.int64(-1), portal
        if at >= 0.0:
            goal, end = _walk(half_edges, field, shrink, source, portals, portal, chosen, at)
        if goal >= 0 and field[goal] < field[vertex]:
            pieces[piece].edge, pieces[piece + 1].node, pieces[piece + 1].start = -1, goal, end
        else:
            if at >= 0.0 or chosen < 0:  # the walk through triangles led nowhere, or none is possible
                chosen, through = _cheapest_edge(half_edges, offsets, corners, field, shrink, vertex)
                if chosen < 0:
                    return -1
                field[vertex] = max(field[vertex], through / shrink)
            goal, end = _other_end(half_edges, chosen, vertex), portal
            if piece > 0 and goal == pieces[piece - 1].node:  # undo the last piece, which led into a dead end
                vertex, piece = goal, piece - 1
                portal = pieces[piece].start
                continue
            append_edge(half_edges, pieces, piece, portal, chosen, goal)
        vertex, portal = goal, end
        piece += 1
    return -1
