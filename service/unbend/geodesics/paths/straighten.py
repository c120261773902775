"""Straightening of any path over a mesh to a locally shortest one (Xin & Wang 2007; FlipOut, Sharp & Crane 2020).

A path of straight pieces is locally shortest if the angle on each side of each node is at least a half turn. If an
angle is smaller, the fan of faces on that side joins the strips before and after the node to one strip, in which the
path is pulled tight. The new strip contains the old path, so no round makes a path longer.
"""

from __future__ import annotations

import numpy as np

from unbend.geodesics.paths.fans import NO_TURN, append_fan, best_turn, push
from unbend.geodesics.paths.funnel import append_edge, append_piece, edge_in_face, pull_tight
from unbend.jit import kernel

_ROUNDS = 100  # paths need a few rounds; rounding errors might alternate forever
_SPARE = 8  # entries at the end of each array that stay unused, as a safety margin


@kernel
def _trim(half_edges, strip, count, start, goal):
    """Return the range of a strip's portals without those at its ends that touch `start` or `goal`."""
    first, stop = 0, count
    while first < stop:
        leave = half_edges[strip[first].exit]
        if half_edges[leave.after].corner != start and half_edges[leave.before].corner != start:
            break
        first += 1
    while first < stop:
        leave = half_edges[strip[stop - 1].exit]
        if half_edges[leave.after].corner != goal and half_edges[leave.before].corner != goal:
            break
        stop -= 1
    return first, stop


@kernel
def _find_turns(half_edges, offsets, pieces, portals, count, turns):
    found = 0
    for piece in range(1, count):
        turns[piece] = NO_TURN
        if pieces[piece - 1].fresh or pieces[piece].fresh:
            turns[piece] = best_turn(half_edges, offsets, pieces, portals, piece)
            found += turns[piece] != NO_TURN
    return found


@kernel
def _join(half_edges, offsets, pieces, portals, piece, stop, turns, strip):
    """Join the strips of pieces `piece` to `stop` - 1 and the fans between them to one strip.

    Return the number of portals, -1 if `strip` is too small, and a half-edge of the first face. That half-edge is
    needed if the strip has no portals.
    """
    count, arrived = np.int64(0), np.int64(-1)
    inside = turns[piece + 1] if pieces[piece].edge >= 0 else portals[pieces[piece].start].exit
    for current in range(piece, stop):
        end = pieces[current + 1].node
        most = pieces[current + 1].start - pieces[current].start + offsets[end + 1] - offsets[end]
        if count + most + _SPARE >= len(strip):
            return -1, inside
        portal, end = pieces[current].start, pieces[current + 1].start
        while portal < end and count > 0 and strip[count - 1].entry == portals[portal].exit:
            count = push(strip, count, portals[portal].exit, portals[portal].entry)
            portal += 1
        while portal < end:
            strip[count] = portals[portal]
            count, portal = count + 1, portal + 1
        if current + 1 < stop:
            turn = turns[current + 1]
            if arrived >= 0 and arrived != turn and pieces[current].edge >= 0:
                count = push(strip, count, arrived, turn)
            arrived, count = append_fan(half_edges, offsets, pieces, portals, current + 1, turn, strip, count)
    return count, inside


@kernel
def _pull(half_edges, offsets, path, piece, stop, turns, work, new, made, portal):
    """Pull the pieces `piece` to `stop` - 1 of `path` tight, and append the result to `new`.

    Return the new numbers of pieces and portals. The first is -1 if `new` is full.
    """
    pieces, (strip, points, ends, deque) = path[0], work
    start, goal = pieces[piece].node, pieces[stop].node
    count, inside = _join(half_edges, offsets, pieces, path[1], piece, stop, turns, strip)
    if count < 0 or portal + count + _SPARE >= len(new[1]) or made + count + _SPARE >= len(new[0]):
        return -1, portal
    first, end = _trim(half_edges, strip, count, start, goal)
    if first == end:
        if first < count:
            inside = strip[first].exit
        elif count > 0:
            inside = strip[count - 1].entry
        append_edge(half_edges, new[0], made, portal, edge_in_face(half_edges, inside, start, goal), goal)
        return made + 1, portal
    point = pull_tight(half_edges, strip, first, end, points, ends, deque)
    depth = 0
    while point >= 0:  # the deque is reused for the points from the goal to the start
        deque[depth] = point
        depth += 1
        point = points[point].parent
    for index in range(depth - 1, 0, -1):
        here, there = deque[index], deque[index - 1]
        portal = append_piece(half_edges, strip, points, ends, here, there, end, new[0], made, new[1], portal)
        made += 1
    return made, portal


@kernel
def _copy(path, piece, new, made, portal, fresh):
    pieces, portals = path
    new[0][made] = pieces[piece]
    new[0][made].start, new[0][made].fresh = portal, fresh
    for index in range(pieces[piece].start, pieces[piece + 1].start):
        new[1][portal] = portals[index]
        portal += 1
    new[0][made + 1].node, new[0][made + 1].start = pieces[piece + 1].node, portal
    return portal


@kernel
def _rebuild(half_edges, offsets, path, count, turns, work, new, raw):
    """Write `path` to `new`, joining the strips on both sides of each node that has a turn.

    The strips of a `raw` path are not straight, so all of them are pulled tight. Return the number of pieces, -1 if
    `new` is full.
    """
    pieces = path[0]
    made = portal = piece = np.int64(0)
    new[0][0].node, new[0][0].start = pieces[0].node, 0
    while piece < count:
        stop = piece + 1
        while stop < count and turns[stop] != NO_TURN:
            stop += 1
        if stop == piece + 1 and (pieces[piece].edge >= 0 or not raw):
            portal = _copy(path, piece, new, made, portal, raw)
            made += 1
        else:
            made, portal = _pull(half_edges, offsets, path, piece, stop, turns, work, new, made, portal)
            if made < 0:
                return -1
        piece = stop
    return made


@kernel
def path_length(pieces, count):
    """Return the length of a path."""
    total = 0.0
    for piece in range(count):
        total += pieces[piece].length
    return total


@kernel
def shorten(half_edges, offsets, path, count, spare, turns, work):
    """Shorten a raw path until it is locally shortest.

    Return the arrays of the new path, the spare arrays, and the number of pieces, -1 if the arrays are too small.
    """
    turns[: count + 1] = NO_TURN
    made = _rebuild(half_edges, offsets, path, count, turns, work, spare, np.bool_(True))
    if made < 0:
        return path, spare, -1
    path, spare, count = spare, path, made
    length = path_length(path[0], count)
    for _ in range(_ROUNDS):
        if _find_turns(half_edges, offsets, path[0], path[1], count, turns) == 0:
            break
        made = _rebuild(half_edges, offsets, path, count, turns, work, spare, np.bool_(False))
        if made < 0:
            break
        changed = path_length(spare[0], made)
        if not changed <= length:  # only rounding makes a path longer
            break
        path, spare, count, length = spare, path, made, changed
    return path, spare, count
