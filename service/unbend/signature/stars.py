"""A simplicial complex for edge collapses: the star of each vertex is a linked list of corners.

The surface need not be manifold or oriented: a face is three corners, and each vertex lists its corners. Corner
`3 f + i` is corner i of face f. A corner whose vertex is -1 belongs to a removed face.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from unbend.jit import kernel

CORNER: Final = np.dtype([("vertex", np.int32), ("next", np.int32)])
NODE: Final = np.dtype(
    [
        ("head", np.int32),  # first corner of the list
        ("tail", np.int32),  # last corner of the list
        ("size", np.int32),  # number of faces
        ("stale", np.int32),  # number of corners in the list whose faces are removed
        ("kind", np.int32),  # REGULAR, CREASE or POINT
        ("cell", np.int32),  # index of the nearest sample
        ("rank", np.int32),  # index of this vertex among the samples, -1 for other vertices
        ("mark", np.int32),  # mark of the last ring that contained this vertex
        ("count", np.int32),  # number of faces that this vertex shares with the centre of that ring
        ("across", np.int32),  # exclusive or of this vertex' neighbours in that ring
        ("seen", np.int32),  # token of the last test that visited this vertex
        ("version", np.int32),  # number of changes to the faces around this vertex
        ("queued", np.int32),  # 1 if this vertex is in the queue
    ]
)

LARGEST_STAR: Final = 1024
"""Largest number of faces in a star that is searched. The limit keeps the time linear for fans of any size."""

REGULAR: Final = 0  # the faces around the vertex are a disc
CREASE: Final = 1  # they are half-discs with a common diameter: one at a boundary, three or more where sheets meet
POINT: Final = 2  # they are anything else


@kernel
def build(faces, edges, nearest, samples):
    """Return corners and nodes of `faces`, without degenerate and duplicate faces."""
    corners, nodes = np.empty(3 * len(faces), CORNER), np.zeros(len(nearest), NODE)
    for vertex in range(len(nearest)):
        node = nodes[vertex]
        node.head = node.tail = node.rank = -1
        node.cell = nearest[vertex]
    for rank in range(len(samples)):
        nodes[samples[rank]].rank = nodes[samples[rank]].cell = rank
    for face in range(len(faces)):
        a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
        lost = a in (b, c) or b == c
        for corner in range(3):
            corners[3 * face + corner].vertex = -1 if lost else faces[face, corner]
    _drop_doubles(corners, nodes, edges)
    for corner in range(len(corners) - 1, -1, -1):
        vertex = corners[corner].vertex
        if vertex >= 0:
            node = nodes[vertex]
            corners[corner].next = node.head
            node.tail = corner if node.head < 0 else node.tail
            node.head = corner
            node.size += 1
    return corners, nodes


@kernel
def _drop_doubles(corners, nodes, edges):
    """Remove duplicate faces, which share an edge and have the same vertex opposite that edge."""
    order, starts, counts = edges
    token = 0
    for edge in range(len(starts)):
        if counts[edge] < 2:
            continue
        token += 1
        for index in range(starts[edge], starts[edge] + counts[edge]):
            half_edge = order[index]
            opposite = corners[half_edge].vertex
            if opposite < 0:
                continue
            if nodes[opposite].seen == token:
                _erase(corners, half_edge // 3)
            nodes[opposite].seen = token
    for vertex in range(len(nodes)):
        nodes[vertex].seen = 0


@kernel
def faces_at(corners, nodes, vertex, end):
    """Return the number of faces that contain both vertices."""
    count = 0
    corner = nodes[vertex].head
    while corner >= 0:
        count += corners[corner].vertex >= 0 and end in others(corners, corner)
        corner = corners[corner].next
    return count


@kernel
def _erase(corners, face):
    for corner in range(3 * face, 3 * face + 3):
        corners[corner].vertex = -1


@kernel
def remove(corners, nodes, face):
    """Remove a face. Its corners stay in the lists until `sweep`."""
    for corner in range(3 * face, 3 * face + 3):
        node = nodes[corners[corner].vertex]
        node.size -= 1
        node.stale += 1
    _erase(corners, face)


@kernel
def has_face(corners, nodes, a, b, c):
    """Return whether three different vertices form a face, by a search of the smallest of their stars."""
    if nodes[b].size < nodes[a].size:
        a, b = b, a
    if nodes[c].size < nodes[a].size:
        a, c = c, a
    corner = nodes[a].head
    while corner >= 0:
        if corners[corner].vertex >= 0:
            d, e = others(corners, corner)
            if (d == b and e == c) or (d == c and e == b):
                return True
        corner = corners[corner].next
    return False


@kernel
def others(corners, corner):
    """Return the other two vertices of a corner's face, in the face's order."""
    place = corner % 3
    after = corner + 1 if place < 2 else corner - 2
    before = corner - 1 if place > 0 else corner + 2
    return corners[after].vertex, corners[before].vertex


@kernel
def sweep(corners, nodes, vertex):
    """Remove the corners of removed faces from a vertex' list."""
    node = nodes[vertex]
    last, corner = -1, node.head
    while corner >= 0 and node.stale > 0:
        following = corners[corner].next
        if corners[corner].vertex >= 0:
            last = corner
        else:
            node.stale -= 1
            if last < 0:
                node.head = following
            else:
                corners[last].next = following
            if following < 0:
                node.tail = last
        corner = following


@kernel
def walk_ring(corners, nodes, vertex, mark, ring):
    """Write the neighbours of `vertex` to `ring`, and `count` and `across` to their nodes; return their number."""
    sweep(corners, nodes, vertex)
    count = 0
    corner = nodes[vertex].head
    while corner >= 0:
        pair = others(corners, corner)
        for index in range(2):
            node = nodes[pair[index]]
            if node.mark != mark:
                node.mark = mark
                node.count = node.across = 0
                ring[count] = pair[index]
                count += 1
            node.count += 1
            node.across ^= pair[1 - index]
        corner = corners[corner].next
    return count


@kernel
def classify(corners, nodes, vertex, mark, ring):
    """Return the kind of a vertex, found by walks along its link."""
    if nodes[vertex].size > LARGEST_STAR:
        return POINT
    count = walk_ring(corners, nodes, vertex, mark, ring)
    creases, first, second = 0, -1, -1
    for index in range(count):
        if nodes[ring[index]].count != 2:
            first, second = ring[index], first
            creases += 1
    if creases == 0:
        start, following = others(corners, nodes[vertex].head)
        steps, _ = _walk_arc(nodes, start, following)
        return REGULAR if steps == count else POINT
    if creases != 2 or nodes[first].count != nodes[second].count:
        return POINT
    walked = 2
    corner = nodes[vertex].head
    while corner >= 0:
        a, b = others(corners, corner)
        if first in (a, b):
            steps, end = _walk_arc(nodes, first, b if a == first else a)
            if end != second:
                return POINT
            walked += steps - 1
        corner = corners[corner].next
    return CREASE if walked == count else POINT


@kernel
def classify_all(corners, nodes):
    """Write the kind of every vertex that has faces; return the clock, which distinguishes the marks of rings."""
    ring = np.empty(len(nodes), np.int32)
    clock = 0
    for vertex in range(len(nodes)):
        if nodes[vertex].size > 0:
            clock += 1
            nodes[vertex].kind = classify(corners, nodes, vertex, clock, ring)
    return clock


@kernel
def _walk_arc(nodes, start, following):
    """Walk along a link from `start` to a crease or back to `start`; return the number of steps and the end."""
    before, here, steps = start, following, 1
    while here != start and nodes[here].count == 2:
        before, here = here, nodes[here].across ^ before
        steps += 1
    return steps, here


@kernel
def remaining(corners, nodes):
    """Return the remaining faces as indices into the samples."""
    faces = np.empty((len(corners) // 3, 3), np.int32)
    count = 0
    for face in range(len(faces)):
        if corners[3 * face].vertex >= 0:
            for corner in range(3):
                faces[count, corner] = nodes[corners[3 * face + corner].vertex].rank
            count += 1
    return faces[:count].copy()
