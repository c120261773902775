"""Half-edge collapses: a vertex moves onto a neighbour, and the faces at their edge are removed (Melax 1998)."""

from __future__ import annotations

from heapq import heappop, heappush
from typing import Any, Final

import numpy as np

from unbend.arrays import Floats, Ints
from unbend.jit import kernel
from unbend.mesh.surface import Surface
from unbend.signature.links import SAME_SURFACE, TORN, damage
from unbend.signature.stars import (
    REGULAR,
    build,
    classify,
    classify_all,
    has_face,
    others,
    remaining,
    remove,
    walk_ring,
)

_UNKNOWN: Final = -1  # sorts before every known harm
_LARGEST_UPDATED: Final = 32  # faces around a vertex beyond which it neither causes nor gets new entries in the heap


def collapse_onto_samples(surface: Surface, nearest: Ints, samples: Ints, distances: Floats) -> Ints:
    """Collapse edges until only samples are left; return the remaining faces, (f, 3), as indices into `samples`.

    Vertices move within the cells of `nearest` first: if all reach their samples, every order gives the
    same faces. The remaining vertices then move across cells, where the order matters.
    """
    edges = surface.edges
    corners, nodes = build(surface.faces, (edges.order, edges.starts, edges.counts), nearest, samples)
    clock = classify_all(corners, nodes)
    clock = _collapse_cells(corners, nodes, clock)
    _collapse_rest(corners, nodes, distances, clock)
    return np.asarray(remaining(corners, nodes))


@kernel
def _collapse_cells(corners, nodes, clock):
    """Collapse edges within cells while the surface keeps its topology."""
    ring, queue = np.empty(len(nodes), np.int32), np.empty(len(nodes), np.int32)
    place, waiting = 0, 0
    for vertex in range(len(nodes)):
        if nodes[vertex].rank < 0 and nodes[vertex].size > 0:
            nodes[vertex].queued = 1
            queue[waiting] = vertex
            waiting += 1
    while waiting > 0:
        vertex = queue[place]
        place = (place + 1) % len(queue)
        waiting -= 1
        node = nodes[vertex]
        node.queued = 0
        clock += 1
        mark = clock
        count = walk_ring(corners, nodes, vertex, mark, ring)
        for index in range(count):
            goal = np.int64(ring[index])
            if nodes[goal].cell != node.cell or (node.kind != REGULAR and nodes[goal].count == 2):
                continue
            clock += 1
            if damage(corners, nodes, vertex, goal, mark, clock) == SAME_SURFACE:
                move(corners, nodes, vertex, goal)
                for other in range(count):
                    near = nodes[ring[other]]
                    if near.rank < 0 and near.queued == 0:
                        near.queued = 1
                        queue[(place + waiting) % len(queue)] = ring[other]
                        waiting += 1
                break
    return clock


@kernel
def move(corners, nodes, vertex, goal):
    """Collapse the edge from `vertex` to `goal`, which takes over the remaining faces of `vertex`."""
    node, there = nodes[vertex], nodes[goal]
    corner = node.head
    while corner >= 0:
        following = corners[corner].next
        if corners[corner].vertex >= 0:
            a, b = others(corners, corner)
            if goal in (a, b):
                remove(corners, nodes, corner // 3)
            else:
                corners[corner].vertex = goal
                corners[corner].next = there.head
                there.tail = corner if there.head < 0 else there.tail
                there.head = corner
                there.size += 1
        corner = following
    node.head = node.tail = -1
    node.size = node.stale = 0


@kernel
def _collapse_rest(corners, nodes, distances, clock):
    """Collapse across cells: first edges that keep the topology, then those that keep the homotopy type, then the rest.

    A heap entry has the cost of a vertex' best collapse when it was last evaluated. It is evaluated again when it is
    popped, and when nearby faces have changed.
    """
    ring, spare = np.empty(len(nodes), np.int32), np.empty(len(nodes), np.int32)
    heap: Any = [(_UNKNOWN, 0.0, np.int64(0), np.int64(-1))]
    for vertex in range(len(nodes)):
        if nodes[vertex].rank < 0 and nodes[vertex].size > 0:
            heappush(heap, (_UNKNOWN, 0.0, np.int64(vertex), np.int64(0)))
    updates_left = len(nodes)  # after collapses that change the surface: loose triangles must not take forever
    while len(heap) > 0:
        harm, cost, vertex, version = heappop(heap)
        if nodes[vertex].version != version or nodes[vertex].size == 0:
            continue
        clock += 1
        count = walk_ring(corners, nodes, vertex, clock, ring)
        found_harm, found_cost, goal, clock = _best_goal(corners, nodes, ring, count, distances, vertex, clock)
        if harm < found_harm or (harm == found_harm and cost < found_cost):
            heappush(heap, (found_harm, found_cost, vertex, version))
            continue
        if found_harm == TORN:
            _remove_twins(corners, nodes, vertex, goal)
        move(corners, nodes, vertex, goal)
        if found_harm != SAME_SURFACE:
            clock = _reclassify(corners, nodes, ring, count, spare, clock)
        clock += 1
        for index in range(count):
            if nodes[ring[index]].size <= _LARGEST_UPDATED and (found_harm == SAME_SURFACE or updates_left > 0):
                updates_left -= _requeue_neighbours(corners, nodes, ring[index], clock, heap)


@kernel
def _best_goal(corners, nodes, ring, count, distances, vertex, clock):
    """Return the best collapse of `vertex`: its harm, its cost, the neighbour to move onto, and the clock."""
    mark = clock
    best: Any = (TORN + 1, np.inf, -1)
    for index in range(count):
        goal = np.int64(ring[index])
        clock += 1
        harm = damage(corners, nodes, vertex, goal, mark, clock)
        if harm < TORN:
            cost = _longest_edge(nodes, ring, count, distances, goal)
        else:
            cost = distances[nodes[vertex].cell, nodes[goal].cell]
        found = (harm, cost, goal)
        best = found if found < best else best  # noqa: FURB136 - Numba's min takes no tuples
    return best[0], best[1], best[2], clock


@kernel
def _longest_edge(nodes, ring, count, distances, goal):
    """Return the longest edge, from cell to cell, that the faces of the ring's centre would have at `goal`."""
    longest = 0.0
    for index in range(count):
        if ring[index] != goal:
            longest = max(longest, distances[nodes[goal].cell, nodes[ring[index]].cell])
    return longest


@kernel
def _remove_twins(corners, nodes, vertex, goal):
    """Remove the faces of `vertex` that would coincide with faces of `goal`."""
    corner = nodes[vertex].head
    while corner >= 0:
        if corners[corner].vertex >= 0:
            a, b = others(corners, corner)
            if has_face(corners, nodes, goal, a, b):
                remove(corners, nodes, corner // 3)
        corner = corners[corner].next


@kernel
def _reclassify(corners, nodes, ring, count, spare, clock):
    for index in range(count):
        if nodes[ring[index]].size > 0:
            clock += 1
            nodes[ring[index]].kind = classify(corners, nodes, ring[index], clock, spare)
    return clock


@kernel
def _requeue_neighbours(corners, nodes, vertex, token, heap):
    """Queue the neighbours of `vertex` with small stars for evaluation; return their number."""
    queued = 0
    corner = nodes[vertex].head
    while corner >= 0:
        if corners[corner].vertex >= 0:
            for end in others(corners, corner):
                node = nodes[end]
                if node.rank < 0 and node.seen != token and node.size <= _LARGEST_UPDATED:
                    node.seen = token
                    node.version += 1
                    queued += 1
                    heappush(heap, (_UNKNOWN, 0.0, np.int64(end), np.int64(node.version)))
        corner = corners[corner].next
    return queued
