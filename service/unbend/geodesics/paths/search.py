"""Searches for shortest paths: descend a distance field, straighten the path, keep the best."""

from __future__ import annotations

import numpy as np

from unbend.geodesics.paths.descent import descend
from unbend.geodesics.paths.funnel import append_edge, pull_tight, turn
from unbend.geodesics.paths.straighten import path_length, shorten
from unbend.jit import kernel


@kernel
def search_shortest(mesh, field, source, target, path, spare, best, work):
    """Find a short path from `target` to `source` by several descents; keep the shortest after straightening.

    The first descent starts at `target`. Each of the others starts at a neighbour of `target` and is preceded by the
    edge to that neighbour. Return the pieces, the portals and the number of pieces, which is 0 if no path was found.
    """
    half_edges, offsets, corners, extent = mesh
    strip, points, ends, deque, turns = work
    scratch = strip, points, ends, deque
    here, there, kept = (path.pieces, path.portals), (spare.pieces, spare.portals), (best.pieces, best.portals)
    made, least = 0, np.inf
    for attempt in range(2 * (offsets[target + 1] - offsets[target]) + 1):
        start, pieces = target, here[0]
        if attempt > 0:
            corner = half_edges[corners[offsets[target] + (attempt - 1) // 2]]
            edge, other = (corner.before, corner.after) if attempt % 2 else (corner.after, corner.before)
            start, pieces = half_edges[other].corner, here[0][1:]
            here[0][0].node = target
            append_edge(half_edges, here[0], np.int64(0), np.int64(0), edge, start)
        count = descend(half_edges, offsets, corners, field, 1.0 / extent, source, start, pieces, here[1])
        if count >= 0 and attempt > 0:
            count += 1
        if count > 0:
            here, there, count = shorten(half_edges, offsets, here, count, there, turns, scratch)
        if count > 0 and path_length(here[0], count) < least:
            least, made = path_length(here[0], count), count
            here, kept = kept, here
    return kept[0], kept[1], made


@kernel
def straighten_walk(mesh, vertices, path, spare, work):
    """Straighten a walk from vertex to vertex along edges; return a path in the form of `search_shortest`."""
    half_edges, offsets, corners, _ = mesh
    strip, points, ends, deque, turns = work
    here, there = (path.pieces, path.portals), (spare.pieces, spare.portals)
    here[0][0].node = vertices[0]
    for step in range(len(vertices) - 1):
        edge = _edge_between(half_edges, offsets, corners, vertices[step], vertices[step + 1])
        if edge < 0 or step + 1 >= len(here[0]):
            return here[0], here[1], 0
        append_edge(half_edges, here[0], step, np.int64(0), edge, vertices[step + 1])
    count = len(vertices) - 1
    here, there, count = shorten(half_edges, offsets, here, count, there, turns, (strip, points, ends, deque))
    return here[0], here[1], max(count, 0)


@kernel
def _edge_between(half_edges, offsets, corners, start, goal):
    for index in range(offsets[start], offsets[start + 1]):
        opposite = half_edges[corners[index]]
        if half_edges[opposite.after].corner == goal:
            return opposite.before
        if half_edges[opposite.before].corner == goal:
            return opposite.after
    return -1


@kernel
def crossings(half_edges, pieces, portals, count, points, ends, deque, first, second, share):
    """Write the points where a path has nodes or crosses edges.

    Each point lies at `share` of the way from vertex `first` to vertex `second`.
    """
    place = 0
    for piece in range(count + 1):
        first[place] = second[place] = pieces[piece].node
        share[place] = 0.0
        place += 1
        if piece == count or pieces[piece].edge >= 0:
            continue
        goal = pull_tight(half_edges, portals, pieces[piece].start, pieces[piece + 1].start, points, ends, deque)
        for portal in range(pieces[piece].start, pieces[piece + 1].start):
            right, left = ends[portal].right, ends[portal].left
            to_right, to_left = (
                -turn(points[0], points[goal], points[right]),
                turn(points[0], points[goal], points[left]),
            )
            across = to_right + to_left
            first[place], second[place] = points[right].vertex, points[left].vertex
            share[place] = min(max(to_right / across, 0.0), 1.0) if across > 0.0 else 0.5
            place += 1
