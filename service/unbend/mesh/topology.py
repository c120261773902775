"""Edges of a triangle list, and neighbours across them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from unbend.arrays import Ints
from unbend.brief import brief, counted, noted
from unbend.jit import inlined, kernel


@dataclass(frozen=True)
class Edges:
    """The undirected edges of a triangle list, found by sorting its half-edges once.

    Half-edge `3 f + i` is opposite corner `i` of face `f`. `order` lists the half-edges edge by edge; `starts` has the
    place in `order` where each edge begins, and `counts` has the edge's number of faces.
    """

    order: Ints  # (3 m,) int32
    starts: Ints  # (e,) int32
    counts: Ints  # (e,) int32

    def __repr__(self) -> str:
        return brief(self, counted(len(self.starts), "edge"), noted(self.boundary, "boundary edge"))

    @property
    def boundary(self) -> int:
        """Number of edges with a single face."""
        return int((self.counts == 1).sum())

    @property
    def nonmanifold(self) -> int:
        """Number of edges with three faces or more."""
        return int((self.counts > 2).sum())

    def twins(self) -> Ints:
        """Return for each half-edge the next one of the same edge, cyclically, or -1 on the boundary, (3 m,) int32."""
        twins: Ints = _twins(self.order, self.starts, self.counts)
        return twins


def find_edges(faces: Ints, vertex_count: int) -> Edges:
    """Find the edges of `faces` (m, 3): O(n + m)."""
    order = np.empty(3 * len(faces), np.int32)
    spare = np.arange(3 * len(faces), dtype=np.int32)
    _sort_by_end(faces, vertex_count, True, spare, order)
    _sort_by_end(faces, vertex_count, False, order, spare)
    starts = _edge_starts(faces, spare)
    return Edges(spare, starts, np.diff(starts, append=np.int32(len(spare))).astype(np.int32))


@inlined
def _end(a, b, larger):
    return max(a, b) if larger else min(a, b)


@kernel
def _sort_by_end(faces, vertex_count, larger, before, after):
    """Sort half-edges by their larger or smaller vertex with a stable counting sort."""
    places = np.zeros(vertex_count + 1, np.int32)
    for half_edge in range(len(before)):
        face, corner = half_edge // 3, half_edge % 3
        places[_end(faces[face, (corner + 1) % 3], faces[face, (corner + 2) % 3], larger) + 1] += 1
    for vertex in range(vertex_count):
        places[vertex + 1] += places[vertex]
    for half_edge in before:
        face, corner = half_edge // 3, half_edge % 3
        end = _end(faces[face, (corner + 1) % 3], faces[face, (corner + 2) % 3], larger)
        after[places[end]] = half_edge
        places[end] += 1


@kernel
def _edge_starts(faces, order):
    starts = np.empty(len(order), np.int32)
    count = 0
    low_before, high_before = np.int32(-1), np.int32(-1)
    for index in range(len(order)):
        face, corner = order[index] // 3, order[index] % 3
        a, b = faces[face, (corner + 1) % 3], faces[face, (corner + 2) % 3]
        low, high = min(a, b), max(a, b)
        if low != low_before or high != high_before:
            starts[count] = index
            count += 1
            low_before, high_before = low, high
    return starts[:count].copy()


@kernel
def _twins(order, starts, counts):
    twins = np.empty(len(order), np.int32)
    for edge in range(len(starts)):
        for index in range(counts[edge]):
            following = starts[edge] + (index + 1) % counts[edge]
            twins[order[starts[edge] + index]] = order[following] if counts[edge] > 1 else -1
    return twins
