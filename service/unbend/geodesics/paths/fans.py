"""Turns around a node of a path, over the faces on one side of the node.

At a node, one piece of the path ends and the next piece starts. A *spoke* is a half-edge of an edge at the node. A
*fan* is the sequence of faces around the node from the first piece to the next, on one side of the path. A *turn* is
the half-edge that identifies a fan. If the first piece runs along an edge, the turn is the half-edge of that edge in
the first face of the fan. If the first piece runs through a strip, the turn is the spoke over which the fan leaves the
last face of the strip.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from unbend.jit import inlined, kernel

HALF_TURN: Final = np.pi - 1e-9  # a smaller bend would shorten the path by only 1e-18 of its length
NO_TURN: Final = -1
BACK: Final = -2  # the path leaves the node through the portal by which it arrived


@kernel
def push(strip, count, leave, enter):
    """Append a portal to a strip; return the new number of portals.

    If the path returns through the last portal, that portal is removed instead.
    """
    if count > 0 and strip[count - 1].entry == leave:
        count -= 1
        leave = strip[count].exit
    if leave != enter:
        strip[count].exit, strip[count].entry = leave, enter
        count += 1
    return count


@inlined
def _other_sides(spoke, after, vertex):
    """Return the other two half-edges in the face of `spoke`: the one opposite `vertex`, and the other spoke.

    `spoke` is the record of a half-edge at `vertex`, and `after` the record of the half-edge `spoke.after`.
    """
    return (spoke.after, spoke.before) if after.corner == vertex else (spoke.before, spoke.after)


@inlined
def _angle_to_piece(portal, from_first_end, spoke):
    """Return the angle between `spoke` and a piece in the same face, which crosses the face's side `portal`.

    `from_first_end` is the piece's `head` or `tail`: the angle between the piece and the first end of `portal`.
    """
    return from_first_end if spoke == portal.before else portal.angle - from_first_end


@kernel
def _sweep(half_edges, limit, vertex, goal, leave, head, spoke, angle, strip, count):
    """Sweep over the faces around `vertex`, starting at `spoke`, until the next piece is found.

    The next piece runs along the edge to `goal`, or leaves the node's face through half-edge `leave` at the angle
    `head`. `angle` is the angle before the sweep. At most `limit` faces are visited.

    Return the total angle, the last spoke and the new number of portals in `strip`. The total angle is inf if a half
    turn is exceeded or an edge cannot be crossed. Portals are appended only if `count` is at least 0.
    """
    for _ in range(limit):
        _, other = _other_sides(half_edges[spoke], half_edges[half_edges[spoke].after], vertex)
        if leave < 0 and half_edges[other].corner == goal:
            return angle, spoke, count
        entry = half_edges[spoke].twin
        if angle >= HALF_TURN or entry < 0 or half_edges[entry].twin != spoke:
            break
        if count >= 0:
            count = push(strip, count, spoke, entry)
        opposite, spoke = _other_sides(half_edges[entry], half_edges[half_edges[entry].after], vertex)
        if opposite == leave:
            return angle + _angle_to_piece(half_edges[leave], head, entry), entry, count
        angle += half_edges[opposite].angle
    return np.inf, spoke, count


@kernel
def _follow_turn(half_edges, offsets, pieces, portals, piece, turn, strip, count):
    """Sweep around the node where `piece` starts, from the piece before it, as `turn` says.

    Return what `_sweep` returns.
    """
    vertex, goal = pieces[piece].node, pieces[piece + 1].node
    leave = -1 if pieces[piece].edge >= 0 else portals[pieces[piece].start].exit
    head = pieces[piece].head
    limit = offsets[vertex + 1] - offsets[vertex]
    if pieces[piece - 1].edge < 0:
        enter = portals[pieces[piece].start - 1].entry
        angle = _angle_to_piece(half_edges[enter], pieces[piece - 1].tail, turn)
        return _sweep(half_edges, limit, vertex, goal, leave, head, turn, angle, strip, count)
    opposite, spoke = _other_sides(half_edges[turn], half_edges[half_edges[turn].after], vertex)
    if opposite == leave:
        return _angle_to_piece(half_edges[leave], head, turn), turn, count
    angle = half_edges[opposite].angle
    return _sweep(half_edges, limit, vertex, goal, leave, head, spoke, angle, strip, count)


@kernel
def append_fan(half_edges, offsets, pieces, portals, piece, turn, strip, count):
    """Append the portals of the fan before `piece` to `strip`; return the last spoke and the new number of portals."""
    if turn == BACK:
        return -1, count
    _, spoke, count = _follow_turn(half_edges, offsets, pieces, portals, piece, turn, strip, count)
    return spoke, count


@kernel
def best_turn(half_edges, offsets, pieces, portals, piece):
    """Return the turn of smallest angle around the node where `piece` starts; NO_TURN if none is below a half turn."""
    best, turn = HALF_TURN, NO_TURN
    edge = pieces[piece - 1].edge
    if edge < 0:
        enter = portals[pieces[piece].start - 1].entry
        if pieces[piece].edge < 0 and portals[pieces[piece].start].exit == enter:
            return BACK
        first, second = half_edges[enter].before, half_edges[enter].after
    else:
        first, second = edge, -1
    candidate = first
    while candidate >= 0:
        angle, _, _ = _follow_turn(half_edges, offsets, pieces, portals, piece, candidate, portals, np.int64(-1))
        if angle < best:
            best, turn = angle, candidate
        if edge >= 0:  # after an edge, try each of its faces
            candidate = half_edges[candidate].twin
            candidate = -1 if candidate == first else candidate
        else:  # after a strip, try both spokes of its last face
            candidate = second if candidate == first else -1
    return turn
