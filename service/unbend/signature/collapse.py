"""Half-edge collapses: a vertex moves onto a neighbour, and the faces at the edge between them vanish (Melax 1998)."""

from __future__ import annotations

from heapq import heappop, heappush
from typing import Any, Final

import numpy as np

from unbend.arrays import Floats, Ints
from unbend.jit import kernel
from unbend.mesh.surface import Surface
from unbend.signature.links import SAME_SURFACE, TORN, damage_of
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

_UNKNOWN: Final = -1  # the damage of a collapse that is not evaluated yet; sorts before all known values
_LARGEST_UPDATED: Final = 32  # vertices with more faces neither cause nor get new entries in the heap


def collapse_onto_samples(surface: Surface, nearest: Ints, samples: Ints, distances: Floats) -> Ints:
    """Collapse edges until only samples are left; return the remaining faces, (f, 3), as indices into `samples`.

    First, vertices move within the cells of `nearest`. If all of them reach their samples, every order gives the same
    faces. Then the remaining vertices move across cells, where the order matters.
    """
    edges = surface.edges
    corners, nodes = build(surface.faces, (edges.order, edges.starts, edges.counts), nearest, samples)
    clock = classify_all(corners, nodes)
    clock = _collapse_cells(corners, nodes, clock)
    _collapse_rest(corners, nodes, distances, clock)
    return np.asarray(remaining(corners, nodes))


@kernel
def _collapse_cells(corners, nodes, clock):
    """Collapse edges within cells as long as the surface keeps its topology."""
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
            if damage_of(corners, nodes, vertex, goal, mark, clock) == SAME_SURFACE:
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
    """Collapse the edge from `vertex` to `goal`, which gets the remaining faces of `vertex`."""
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
    """Collapse edges across cells.

    Edges that keep the topology come first, then edges that keep the homotopy type, then all others. A heap entry has
    the cost of a vertex' best collapse at its last evaluation. The collapse is evaluated again when the entry is
    popped, and when nearby faces have changed.
    """
    ring, spare = np.empty(len(nodes), np.int32), np.empty(len(nodes), np.int32)
    heap: Any = [(_UNKNOWN, 0.0, np.int64(0), np.int64(-1))]
    for vertex in range(len(nodes)):
        if nodes[vertex].rank < 0 and nodes[vertex].size > 0:
            heappush(heap, (_UNKNOWN, 0.0, np.int64(vertex), np.int64(0)))
    updates_left = len(nodes)  # limits updates after collapses that change the topology, because they may be many
    while len(heap) > 0:
        damage, cost, vertex, version = heappop(heap)
        if nodes[vertex].version != version or nodes[vertex].size == 0:
            continue
        clock += 1
        count = walk_ring(corners, nodes, vertex, clock, ring)
        found_damage, found_cost, goal, clock = _best_goal(corners, nodes, ring, count, distances, vertex, clock)
        if damage < found_damage or (damage == found_damage and cost < found_cost):
            heappush(heap, (found_damage, found_cost, vertex, version))
            continue
        if found_damage == TORN:
            _remove_duplicates(corners, nodes, vertex, goal)
        move(corners, nodes, vertex, goal)
        if found_damage != SAME_SURFACE:
            clock = _reclassify(corners, nodes, ring, count, spare, clock)
        clock += 1
        for index in range(count):
            if nodes[ring[index]].size <= _LARGEST_UPDATED and (found_damage == SAME_SURFACE or updates_left > 0):
                updates_left -= _requeue_neighbours(corners, nodes, ring[index], clock, heap)


@kernel
def _best_goal(corners, nodes, ring, count, distances, vertex, clock):
    """Return the best collapse of `vertex`: its damage, its cost, the neighbour to move onto, and the clock."""
    mark = clock
    best: Any = (TORN + 1, np.inf, -1)
    for index in range(count):
        goal = np.int64(ring[index])
        clock += 1
        damage = damage_of(corners, nodes, vertex, goal, mark, clock)
        if damage < TORN:
            cost = _longest_edge(nodes, ring, count, distances, goal)
        else:
            cost = distances[nodes[vertex].cell, nodes[goal].cell]
        found = (damage, cost, goal)
        best = found if found < best else best  # noqa: FURB136 - Numba's min takes no tuples
    return best[0], best[1], best[2], clock


@kernel
def _longest_edge(nodes, ring, count, distances, goal):
    """Return the longest edge that the faces of the ring's centre would have at `goal`, measured between samples."""
    longest = 0.0
    for index in range(count):
        if ring[index] != goal:
            longest = max(longest, distances[nodes[goal].cell, nodes[ring[index]].cell])
    return longest


@kernel
def _remove_duplicates(corners, nodes, vertex, goal):
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
    """Queue the neighbours of `vertex` that have small stars for evaluation; return their number."""
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
