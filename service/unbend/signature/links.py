"""The effect of an edge collapse on the topology, by the link condition (Dey et al. 1999).

A collapse keeps the topology if the links of both ends meet only in the link of the edge. A crease is a boundary or an
edge of three faces or more. A vertex at a crease may move only along the crease. The same condition ensures this if one
more vertex is added that is connected to every crease.
"""

from __future__ import annotations

from typing import Final

from unbend.jit import kernel
from unbend.signature.stars import CREASE, LARGEST_STAR, REGULAR, faces_at, has_face, others, sweep

SAME_SURFACE: Final = 0  # the collapse gives a homeomorphic surface
SAME_SHAPE: Final = 1  # the collapse keeps only the homotopy type and changes creases
TORN: Final = 2  # the collapse keeps neither

_LARGEST_MOVED: Final = 128  # most faces at a vertex that may move; larger stars shrink as other vertices move


@kernel
def damage_of(corners, nodes, vertex, goal, mark, token):
    """Return the effect on the topology of moving `vertex` onto `goal`.

    `walk_ring` must have visited `vertex` with `mark`.
    """
    kind = nodes[vertex].kind
    if nodes[vertex].size > _LARGEST_MOVED or not keeps_links(corners, nodes, vertex, goal, mark, token):
        return TORN
    if kind == REGULAR:
        return SAME_SURFACE
    along = kind == CREASE and nodes[goal].count != 2
    corner = nodes[vertex].head
    while corner >= 0:
        a, b = others(corners, corner)
        corner = corners[corner].next
        if goal in (a, b):
            opposite = b if a == goal else a
            beside = faces_at(corners, nodes, goal, opposite)
            if beside + nodes[opposite].count == 2:
                return TORN  # that edge would have no faces left
            along = along and (nodes[opposite].count == 2 or beside == 2)
    return SAME_SURFACE if along else SAME_SHAPE


@kernel
def keeps_links(corners, nodes, vertex, goal, mark, token):
    """Return whether the links of `vertex` and `goal` meet only in the link of their edge.

    `walk_ring` must have visited `vertex` with `mark`.
    """
    if nodes[goal].size > LARGEST_STAR:
        return False
    sweep(corners, nodes, goal)
    allowed = nodes[goal].count
    corner = nodes[goal].head
    while corner >= 0:
        a, b = others(corners, corner)
        corner = corners[corner].next
        first, second = nodes[a].mark == mark, nodes[b].mark == mark
        if first and nodes[a].seen != token:
            nodes[a].seen = token
            allowed -= 1
        if second and nodes[b].seen != token:
            nodes[b].seen = token
            allowed -= 1
        if allowed < 0 or (first and second and has_face(corners, nodes, vertex, a, b)):
            return False
    return True
