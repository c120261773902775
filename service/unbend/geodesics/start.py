"""The exact start of a front: shortest paths over the triangles around its source.

Near its source marching makes errors that it carries everywhere: if it starts from the source alone, the error falls
only as h^0.67, for edges of length h. So an exact algorithm runs first, for a bounded number of
events. It unfolds the triangles around the source, nearest first, by windows and pseudo-sources (Chen & Han 1990, in
the order and with the filter of Xin & Wang 2009). Distances below the radius that it covers are exact and final.
Marching starts from all distances found.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from unbend.geodesics.unfolding import angle, apex, apex_beyond
from unbend.jit import borrowing, inlined
from unbend.tolerances import SADDLE, START_EVENTS

_CAPACITY: Final = 16 * START_EVENTS  # maximum number of events; if they run out, the radius is 0
_NEW: Final = 16  # maximum number of events that one window creates, if at most eight triangles meet at an edge
_NEARLY: Final = 1.1  # measured: distances up to this multiple of the radius have smaller errors than marched ones
_FILTERED: Final = 1.0 - 1e-6  # distances are stored in single precision
_GRAZING: Final = 1e-6  # a ray that misses a vertex by less than this share of the distance counts as a hit
_STRAIGHT: Final = np.pi
_FLAT: Final = 2.0 * np.pi + SADDLE


def start_arrays(count: int) -> tuple[np.ndarray, ...]:
    """Return the work arrays of `start_front` for `count` vertices.

    The arrays are the seeds, the half-edge and the vertex of each event, the shape of each event, the keys and the
    items of a heap of events, and three counters.
    """
    return (
        np.empty(count, np.int32), np.empty((_CAPACITY, 2), np.int32), np.empty((_CAPACITY, 9)),
        np.empty(_CAPACITY), np.empty(_CAPACITY, np.int32), np.empty(3, np.int64),
    )  # fmt: skip


_EVENTS, _WAITING, _SEEDS = range(3)  # the counters: events made, waiting in the heap, vertices reached


@borrowing
def start_front(mesh, source, enough, wanted, horizon, value, start):
    """Set `value` along shortest paths from `source`; return the number of vertices reached, and a radius.

    A *pseudo-source* is a vertex where shortest paths bend. A *window* is a side (A, B) of a triangle, unfolded into
    the plane of the source or of a pseudo-source, and the two rays between which the side is visible from there.
    Windows propagate over all other triangles at their side. The vertices reached are listed in `seeds`.
    Marching keeps the values below the returned radius, which is `_NEARLY` times the radius of exact distances.

    The search ends after `enough` events if it has covered the radius `wanted`, otherwise after three times as many. It
    also ends at the distance `horizon`.
    """
    seeds, events, _, keys, items, counters = start
    around = mesh[5]
    counters[:] = 0
    value[source] = 0.0
    seeds[0] = source
    counters[_SEEDS] = 1
    _open_fan(mesh, source, 0.0, value, start)
    done, sure = 0, np.inf if around[source] >= 0.0 else 0.0
    while counters[_WAITING] > 0 and keys[0] <= horizon and counters[_EVENTS] + _NEW <= len(keys):
        if done >= 3 * enough or (done >= enough and keys[0] > wanted):
            break
        key, event = keys[0], items[0]
        counters[_WAITING] = _drop_first(keys, items, counters[_WAITING])
        if events[event, 0] >= 0:
            done += 1
            _cross(mesh, event, value, start)
        elif np.float32(key) <= value[events[event, 1]]:  # no shorter path found since
            if around[events[event, 1]] < 0.0:  # a corner of a triangle whose angles are mostly rounding error
                sure = min(sure, key)
            done += _leave(mesh, event, key, value, start)
    radius = keys[0] if counters[_WAITING] > 0 else np.inf
    if counters[_EVENTS] + _NEW > len(keys):  # some events may have been dropped
        radius = 0.0
    return counters[_SEEDS], _NEARLY * min(radius, sure)


@inlined
def _norm(x, y):
    return np.sqrt(x * x + y * y)


@inlined
def _cross(mesh, event, value, start):
    """Propagate a window over the triangle behind its side."""
    faces, _, lengths, _, _, around = mesh
    _, events, shapes, _, _, _ = start
    half_edge, a = events[event, 0], events[event, 1]
    ax, ay, bx, by = shapes[event, 0], shapes[event, 1], shapes[event, 2], shapes[event, 3]
    right_x, right_y, left_x, left_y = shapes[event, 4], shapes[event, 5], shapes[event, 6], shapes[event, 7]
    before = shapes[event, 8]
    face, j = half_edge // 3, half_edge % 3
    at_a, at_b = 3 * face + (j + 1) % 3, 3 * face + (j + 2) % 3
    if faces[face, (j + 1) % 3] != a:
        at_a, at_b = at_b, at_a
    b, d = faces[face, at_b % 3], faces[face, j]
    base = _norm(bx - ax, by - ay)
    if not base > 0.0:
        return
    x, y = apex(lengths[at_b], lengths[at_a], base)
    dx, dy = apex_beyond(ax, ay, bx, by, x, y, base)
    beside_right, beside_left = right_x * dy - right_y * dx, dx * left_y - dy * left_x
    left_of_right, right_of_left = beside_right >= 0.0, beside_left >= 0.0
    least = -_GRAZING * (abs(dx) + abs(dy))
    if beside_right >= least * (abs(right_x) + abs(right_y)) and beside_left >= least * (abs(left_x) + abs(left_y)):
        straight, turn = _norm(dx, dy), 0.0
        if around[d] > _FLAT and straight > 0.0:
            side_x, side_y = (ax, ay) if at_a == 3 * face + (j + 1) % 3 else (bx, by)
            turn = angle(straight, _norm(side_x - dx, side_y - dy), _norm(side_x, side_y))
        _reach(d, before + straight, half_edge, turn, value, start)
    if left_of_right:
        edge_x, edge_y = (dx, dy) if right_of_left else (left_x, left_y)
        _add_window(mesh, at_b, a, d, ax, ay, dx, dy, right_x, right_y, edge_x, edge_y, before, value, start)
    if right_of_left:
        edge_x, edge_y = (dx, dy) if left_of_right else (right_x, right_y)
        _add_window(mesh, at_a, d, b, dx, dy, bx, by, edge_x, edge_y, left_x, left_y, before, value, start)


@inlined
def _add_window(mesh, half_edge, a, b, ax, ay, bx, by, right_x, right_y, left_x, left_y, before, value, start):
    """Queue a window over the side `half_edge`, unless paths through one of the side's ends are shorter everywhere."""
    _, twins, _, _, _, _ = mesh
    _, events, shapes, keys, items, counters = start
    ex, ey = bx - ax, by - ay
    length = _norm(ex, ey)
    right, left = right_x * ey - right_y * ex, left_x * ey - left_y * ex
    first = min(1.0, max(0.0, (right_y * ax - right_x * ay) / right)) if right != 0.0 else 0.0
    last = min(1.0, max(0.0, (left_y * ax - left_x * ay) / left)) if left != 0.0 else 1.0
    if not first < last:
        return
    to_last, to_first = _norm(ax + last * ex, ay + last * ey), _norm(ax + first * ex, ay + first * ey)
    if value[a] + last * length < (before + to_last) * _FILTERED:
        return
    if value[b] + (1.0 - first) * length < (before + to_first) * _FILTERED:
        return
    nearest = min(last, max(first, -(ax * ex + ay * ey) / (length * length)))
    key = before + _norm(ax + nearest * ex, ay + nearest * ey)
    twin = twins[half_edge]
    while twin >= 0 and twin != half_edge and counters[_EVENTS] < len(keys):
        event = counters[_EVENTS]
        events[event, 0], events[event, 1] = twin, a
        shapes[event, 0], shapes[event, 1], shapes[event, 2], shapes[event, 3] = ax, ay, bx, by
        shapes[event, 4], shapes[event, 5], shapes[event, 6], shapes[event, 7] = right_x, right_y, left_x, left_y
        shapes[event, 8] = before
        counters[_EVENTS] = event + 1
        counters[_WAITING] = _insert(keys, items, counters[_WAITING], key, event)
        twin = twins[twin]


@inlined
def _reach(vertex, distance, corner, turn, value, start):
    """Lower the distance of a vertex and queue it, unless a shorter path is known.

    The path arrives in `corner`, at the angle `turn` from the side to the next corner. A path of equal length is queued
    too, because two such paths may pass an obstacle on both sides, and each has its own shadow behind the vertex.
    """
    seeds, events, shapes, keys, items, counters = start
    lower = np.float32(distance)
    if lower > value[vertex]:
        return
    if value[vertex] == np.inf:
        seeds[counters[_SEEDS]] = vertex
        counters[_SEEDS] += 1
    value[vertex] = lower
    event = counters[_EVENTS]
    if event < len(keys):
        events[event, 0], events[event, 1] = -1 - corner, vertex
        shapes[event, 0] = turn
        counters[_EVENTS] = event + 1
        counters[_WAITING] = _insert(keys, items, counters[_WAITING], distance, event)


@inlined
def _leave(mesh, event, distance, value, start):
    """Continue paths from a vertex along its edges, and open windows behind the vertex if paths may bend there.

    Return 1 if they may, else 0. Paths along the edges are needed everywhere, because rounding loses rays
    that graze a vertex, and windows alone would miss the edges behind it.
    """
    faces, _, lengths, starts, corners, around = mesh
    events = start[1]
    vertex = events[event, 1]
    if around[vertex] == np.inf:  # a boundary, or several fans: paths may continue into every triangle
        _open_fan(mesh, vertex, distance, value, start)
        return 1
    for index in range(starts[vertex], starts[vertex + 1]):
        face, i = corners[index] // 3, corners[index] % 3
        at_a, at_b = 3 * face + (i + 1) % 3, 3 * face + (i + 2) % 3
        if distance + lengths[at_b] < value[faces[face, at_a % 3]]:
            turn = _turn_back(mesh, at_a, lengths[at_b], lengths[corners[index]], lengths[at_a])
            _reach(faces[face, at_a % 3], distance + lengths[at_b], at_a, turn, value, start)
    if around[vertex] > _FLAT:
        _bend(mesh, event, distance, value, start)
        return 1
    return 0


@inlined
def _turn_back(mesh, corner, to_next, across, opposite):
    """Return the angle in `corner` between its two sides; 0 at vertices where paths do not bend."""
    faces, around = mesh[0], mesh[5]
    saddle = around[faces[corner // 3, corner % 3]] > _FLAT and to_next > 0.0 and across > 0.0
    return angle(to_next, across, opposite) if saddle else 0.0


@inlined
def _bend(mesh, event, distance, value, start):
    """Open windows into the shadow behind a vertex: the directions at least half a turn from the arriving path."""
    faces, twins, lengths, _, _, around = mesh
    _, events, shapes, _, _, _ = start
    vertex, corner = events[event, 1], -1 - events[event, 0]
    side, behind = 3 * (corner // 3) + (corner % 3 + 2) % 3, shapes[event, 0]
    end = around[vertex] - _STRAIGHT
    while behind < end:
        twin = twins[side]  # all faces around this vertex have the same orientation
        face, k = twin // 3, twin % 3
        at_w, at_vertex = 3 * face + (k + 1) % 3, 3 * face + (k + 2) % 3
        to_w, to_u, across = lengths[twin], lengths[at_w], lengths[at_vertex]
        if not (to_w > 0.0 and to_u > 0.0 and across > 0.0):
            return
        own = angle(to_w, to_u, across)
        if behind + own > _STRAIGHT:
            right, left = max(0.0, _STRAIGHT - behind), min(own, end - behind)
            _add_window(
                mesh, at_vertex, faces[face, at_w % 3], faces[face, k], to_w, 0.0, to_u * np.cos(own),
                to_u * np.sin(own), np.cos(right), np.sin(right), np.cos(left), np.sin(left), distance, value, start,
            )  # fmt: skip
        behind += own
        side = at_w


@inlined
def _open_fan(mesh, vertex, distance, value, start):
    """Reach all neighbours of a vertex, and open windows over the sides opposite the vertex."""
    faces, _, lengths, starts, corners, _ = mesh
    for index in range(starts[vertex], starts[vertex + 1]):
        side = corners[index]
        face, i = side // 3, side % 3
        at_a, at_b = 3 * face + (i + 1) % 3, 3 * face + (i + 2) % 3
        to_a, to_b, across = lengths[at_b], lengths[at_a], lengths[side]
        turn = _turn_back(mesh, at_a, to_a, across, to_b)
        _reach(faces[face, at_a % 3], distance + to_a, at_a, turn, value, start)
        if distance + to_b < value[faces[face, at_b % 3]]:  # false if B was reached as the A of another triangle
            _reach(faces[face, at_b % 3], distance + to_b, at_b, 0.0, value, start)
    for index in range(starts[vertex], starts[vertex + 1]):
        side = corners[index]
        face, i = side // 3, side % 3
        at_a, at_b = 3 * face + (i + 1) % 3, 3 * face + (i + 2) % 3
        to_a, to_b = lengths[at_b], lengths[at_a]
        if to_a > 0.0:
            x, y = apex(to_b, lengths[side], to_a)
            a, b = faces[face, at_a % 3], faces[face, at_b % 3]
            _add_window(mesh, side, a, b, to_a, 0.0, x, y, to_a, 0.0, x, y, distance, value, start)


@inlined
def _insert(keys, items, size, key, item):
    """Insert into a binary heap of `size` items; return its new size."""
    place = size
    while place > 0:
        parent = (place - 1) // 2
        if keys[parent] <= key:
            break
        keys[place], items[place] = keys[parent], items[parent]
        place = parent
    keys[place], items[place] = key, item
    return size + 1


@inlined
def _drop_first(keys, items, size):
    """Remove the least item of a binary heap; return its new size."""
    size -= 1
    key, item, place = keys[size], items[size], 0
    while True:
        child = 2 * place + 1
        if child >= size:
            break
        if child + 1 < size and keys[child + 1] < keys[child]:
            child += 1
        if keys[child] >= key:
            break
        keys[place], items[place] = keys[child], items[child]
        place = child
    keys[place], items[place] = key, item
    return size
