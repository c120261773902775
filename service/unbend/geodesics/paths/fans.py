"""The two ways around a node of a path: over the faces on either side of it."""

from __future__ import annotations

from typing import Final

import numpy as np

from unbend.jit import inlined, kernel

HALF_TURN: Final = np.pi - 1e-9  # a bend below this shortens a path by 1e-18 of it
NO_TURN: Final = -1
BACK: Final = -2  # the path leaves the node through the face by which it arrived


@kernel
def push(strip, count, leave, enter):
    """Append a portal to a strip; if it returns through the last portal, remove that one instead."""
    if count > 0 and strip[count - 1].entry == leave:
        count -= 1
        leave = strip[count].exit
    if leave != enter:
        strip[count].exit, strip[count].entry = leave, enter
        count += 1
    return count


@inlined
def _corner(half_edge, after, vertex):
    """Return the half-edge opposite `vertex`, an end of `half_edge`, in the same face; and the third half-edge."""
    return (half_edge.after, half_edge.before) if after.corner == vertex else (half_edge.before, half_edge.after)


@inlined
def _angle_to(leave, head, spoke):
    """Return the angle from `spoke`, an edge at a piece's start, to the piece, which leaves by half-edge `leave`."""
    return head if spoke == leave.before else leave.angle - head


@kernel
def _go_round(half_edges, limit, vertex, goal, leave, head, spoke, angle, strip, count):
    """Turn around `vertex` from `spoke` until a piece is reached: along the edge to `goal`, or through `leave`.

    `angle` is the angle so far. Return the total angle, inf if it exceeds a half turn or an edge cannot be crossed; the
    last spoke; and the end of the strip, to which the portals are appended unless `count` is below 0.
    """
    for _ in range(limit):
        _, other = _corner(half_edges[spoke], half_edges[half_edges[spoke].after], vertex)
        if leave < 0 and half_edges[other].corner == goal:
            return angle, spoke, count
        entry = half_edges[spoke].twin
        if angle >= HALF_TURN or entry < 0 or half_edges[entry].twin != spoke:
            break
        if count >= 0:
            count = push(strip, count, spoke, entry)
        corner, spoke = _corner(half_edges[entry], half_edges[half_edges[entry].after], vertex)
        if corner == leave:
            return angle + _angle_to(half_edges[leave], head, entry), entry, count
        angle += half_edges[corner].angle
    return np.inf, spoke, count


@kernel
def _round(half_edges, offsets, pieces, portals, piece, turn, strip, count):
    """Turn around the node where `piece` starts, from the piece before it, in the direction given by `turn`.

    After an edge, `turn` is a half-edge of it in the first face; after a strip, `turn` is the first spoke.
    """
    vertex, goal = pieces[piece].node, pieces[piece + 1].node
    leave = -1 if pieces[piece].edge >= 0 else portals[pieces[piece].start].exit
    head = pieces[piece].head
    limit = offsets[vertex + 1] - offsets[vertex]
    if pieces[piece - 1].edge < 0:
        enter = portals[pieces[piece].start - 1].entry
        angle = _angle_to(half_edges[enter], pieces[piece - 1].tail, turn)
        return _go_round(half_edges, limit, vertex, goal, leave, head, turn, angle, strip, count)
    corner, spoke = _corner(half_edges[turn], half_edges[half_edges[turn].after], vertex)
    if corner == leave:
        return _angle_to(half_edges[leave], head, turn), turn, count
    angle = half_edges[corner].angle
    return _go_round(half_edges, limit, vertex, goal, leave, head, spoke, angle, strip, count)


@kernel
def fan_from(half_edges, offsets, pieces, portals, piece, turn, strip, count):
    """Append the faces of a turn to the strip; return the last spoke and the end of the strip."""
    if turn == BACK:
        return -1, count
    _, spoke, count = _round(half_edges, offsets, pieces, portals, piece, turn, strip, count)
    return spoke, count


@kernel
def best_turn(half_edges, offsets, pieces, portals, piece):
    """Return the turn around the node before `piece` on its narrower side, NO_TURN if neither is below a half turn."""
    best, turn = HALF_TURN, NO_TURN
    edge = pieces[piece - 1].edge
    if edge < 0:
        enter = portals[pieces[piece].start - 1].entry
        if pieces[piece].edge < 0 and portals[pieces[piece].start].exit == enter:
            return BACK
        first, last = half_edges[enter].before, half_edges[enter].after
    else:
        first, last = edge, -1
    way = first
    while way >= 0:
        angle, _, _ = _round(half_edges, offsets, pieces, portals, piece, way, portals, np.int64(-1))
        if angle < best:
            best, turn = angle, way
        if edge >= 0:
            way = half_edges[way].twin
            way = -1 if way == first else way
        else:
            way = last if way == first else -1
    return turn
