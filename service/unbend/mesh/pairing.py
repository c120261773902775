"""Pairs of boundary edges that are the two sides of a seam."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from unbend.arrays import Bools, Floats, Indices, Ints
from unbend.jit import kernel
from unbend.mesh.surface import Surface
from unbend.tolerances import SAME_ANGLE


@dataclass(frozen=True, eq=False)
class Rims:
    """Boundary half-edges of a surface, from vertex `tail` to `head`, opposite vertex `apex`, all (b,)."""

    half_edge: Ints
    tail: Ints
    head: Ints
    apex: Ints

    @classmethod
    def of(cls, surface: Surface) -> Self:
        """Return the boundary half-edges of `surface`."""
        half_edge = surface.edges.order[surface.edges.starts[surface.edges.counts == 1]]
        return cls(half_edge, *corners_of(surface.faces.ravel(), half_edge))

    def __len__(self) -> int:
        return len(self.half_edge)

    def where(self, chosen: Bools | Ints) -> Rims:
        """Return the half-edges that `chosen` selects."""
        return Rims(self.half_edge[chosen], self.tail[chosen], self.head[chosen], self.apex[chosen])

    def without(self, joins: Joins) -> Rims:
        """Return the half-edges that are not in `joins`."""
        joined = np.zeros(int(self.half_edge.max(initial=-1)) + 1, bool)
        joined[joins.half_edges] = True
        return self.where(~joined[self.half_edge])


@dataclass(frozen=True, eq=False)
class Joins:
    """Pairs of half-edges, (k, 2) int32, and the vertices to merge, (k, 2 ends, 2 copies) int32."""

    half_edges: Ints
    ends: Ints

    @classmethod
    def none(cls) -> Self:
        """Return no joins."""
        return cls(np.empty((0, 2), np.int32), np.empty((0, 2, 2), np.int32))

    def __len__(self) -> int:
        return len(self.half_edges)

    def where(self, chosen: Bools) -> Joins:
        """Return the joins that `chosen` selects."""
        return Joins(self.half_edges[chosen], self.ends[chosen])

    def followed_by(self, others: Joins) -> Joins:
        """Return these joins and then `others`."""
        if len(self) == 0:
            return others
        return Joins(np.concatenate([self.half_edges, others.half_edges]), np.concatenate([self.ends, others.ends]))


def joins_between(surface: Surface, rims: Rims, places: Ints, *, soup: bool, misoriented: bool) -> Joins:
    """Return the pairs of `rims` to join; `places` has the place of each vertex, (n,) int32.

    Half-edges are at one place if their ends have the same two places. Two half-edges at a place are a pair if their
    directions are opposite. With `misoriented`, or in a `soup`, in which no two faces share an edge, any directions are
    allowed. Three or more half-edges are paired around the edge, so that each pair bounds the solid between its faces;
    one may stay alone. In a soup, all half-edges at a place are joined if more run in one direction than in the other.
    Coincident faces are never joined.
    """
    tails, heads = places[rims.tail], places[rims.head]
    order = _sorted_by(np.maximum(tails, heads), np.arange(len(rims), dtype=np.int32), len(places))
    order = _sorted_by(np.minimum(tails, heads), order, len(places))
    starts, counts, balance = _groups(tails, heads, order)
    two = (counts == 2) & ((balance == 0) | soup | misoriented)
    around = (counts > 2) & ((balance == 0) | (not soup))
    loose = (counts > 2) & (balance != 0) & soup
    pairs = [
        _chained(order, starts[two], counts[two]),
        _paired_around(surface, rims, places, order, starts[around], counts[around]),
        _chained(order, starts[loose], counts[loose]),
    ]
    return Joins(*_joins(np.concatenate(pairs), rims.half_edge, rims.tail, rims.head, rims.apex, places))


@kernel
def corners_of(vertex: Ints, half_edges: Ints) -> tuple[Ints, Ints, Ints]:
    """Return the tail, the head and the opposite corner of each half-edge, each (b,)."""
    tail, head, apex = np.empty_like(half_edges), np.empty_like(half_edges), np.empty_like(half_edges)
    for i in range(len(half_edges)):
        first, corner = half_edges[i] - half_edges[i] % 3, half_edges[i] % 3
        tail[i], head[i] = vertex[first + (corner + 1) % 3], vertex[first + (corner + 2) % 3]
        apex[i] = vertex[half_edges[i]]
    return tail, head, apex


@kernel
def _sorted_by(ends: Ints, before: Ints, count: int) -> Ints:
    """Sort half-edges, given in the order `before`, by one of their ends with a stable counting sort."""
    begins = np.zeros(count + 1, np.int32)
    for end in ends:
        begins[end + 1] += 1
    for end in range(count):
        begins[end + 1] += begins[end]
    order = np.empty_like(before)
    for item in before:
        order[begins[ends[item]]] = item
        begins[ends[item]] += 1
    return order


@kernel
def _groups(tails: Ints, heads: Ints, order: Ints) -> tuple[Ints, Ints, Ints]:
    """Return the start in `order`, the size and the balance of each group of half-edges at one place.

    The balance is the number of half-edges from the lower to the higher place minus the number of all others.
    """
    starts, counts, balance = np.empty_like(order), np.zeros_like(order), np.zeros_like(order)
    groups, low, high = 0, -1, -1
    for i in range(len(order)):
        tail, head = tails[order[i]], heads[order[i]]
        if tail == head:
            continue  # an edge without length cannot be a side of a seam
        if min(tail, head) != low or max(tail, head) != high:
            low, high = min(tail, head), max(tail, head)
            starts[groups] = i
            groups += 1
        counts[groups - 1] += 1
        balance[groups - 1] += 1 if tail < head else -1
    return starts[:groups], counts[:groups], balance[:groups]


@kernel
def _joins(pairs: Ints, half_edge: Ints, tail: Ints, head: Ints, apex: Ints, places: Ints) -> tuple[Ints, Ints]:
    """Return the half-edges of `pairs` and the ends to join, without pairs of one face or of coincident faces."""
    half_edges, ends = np.empty((len(pairs), 2), np.int32), np.empty((len(pairs), 2, 2), np.int32)
    count = 0
    for i in range(len(pairs)):
        a, b = pairs[i]
        if half_edge[a] // 3 == half_edge[b] // 3 or places[apex[a]] == places[apex[b]]:
            continue
        half_edges[count, 0], half_edges[count, 1] = half_edge[a], half_edge[b]
        same = places[tail[a]] == places[tail[b]]
        ends[count, 0, 0], ends[count, 0, 1] = tail[a], tail[b] if same else head[b]
        ends[count, 1, 0], ends[count, 1, 1] = head[a], head[b] if same else tail[b]
        count += 1
    return half_edges[:count], ends[:count]


@kernel
def _chained(order: Ints, starts: Ints, counts: Ints) -> Ints:
    """Pair each member of a group with the next member, (k, 2) int32."""
    pairs = np.empty((counts.sum() - len(counts), 2), np.int32)
    count = 0
    for group in range(len(starts)):
        for i in range(starts[group] + 1, starts[group] + counts[group]):
            pairs[count, 0], pairs[count, 1] = order[i - 1], order[i]
            count += 1
    return pairs


def _paired_around(surface: Surface, rims: Rims, places: Ints, order: Ints, starts: Ints, counts: Ints) -> Ints:
    """Pair the members of each group by the angles of their faces around the edge, (k, 2) int32."""
    if len(starts) == 0:
        return np.empty((0, 2), np.int32)
    group = np.repeat(np.arange(len(counts)), counts)
    begins = np.cumsum(counts) - counts
    members = order[np.arange(len(group)) + (starts - begins)[group]]
    members = members[np.lexsort((rims.half_edge[members], group))]
    chosen = rims.where(members)
    forward = places[chosen.tail] < places[chosen.head]
    partner = np.full(len(members), -1)
    solid_ends = forward == (_signed_volume(surface) >= 0)
    _match_around(_angles_around(surface, chosen, places), solid_ends, begins, counts, SAME_ANGLE, partner)
    first = np.flatnonzero(partner >= 0)
    return np.stack([members[first], members[partner[first]]], axis=1).astype(np.int32)


def _angles_around(surface: Surface, rims: Rims, places: Ints) -> Floats:
    """Return the angle of each face around its edge, (b,).

    Angles are counterclockwise for a viewer towards whom the edge points, from its lower to its higher place.
    """
    points = surface.vertices / surface.scale
    tails, heads = places[rims.tail], places[rims.head]
    low, high = points[np.minimum(tails, heads)], points[np.maximum(tails, heads)]
    axis = high - low
    with np.errstate(invalid="ignore"):  # an edge may be too short, compared with the surface, to have a direction
        axis = axis / np.abs(axis).max(axis=1, keepdims=True)
    across = np.cross(axis, np.eye(3)[np.abs(axis).argmin(axis=1)])
    up = np.cross(axis / np.linalg.norm(axis, axis=1)[:, None], across)
    apex = points[rims.apex] - low
    angles: Floats = np.arctan2((apex * up).sum(axis=1), (apex * across).sum(axis=1))
    return angles


def _signed_volume(surface: Surface) -> float:
    """Return a number with the sign of the enclosed volume: positive if faces are counterclockwise from outside."""
    used = surface.vertices[surface.used_vertices] / surface.scale
    a, b, c = np.moveaxis(surface.vertices[surface.faces] / surface.scale - used.mean(axis=0), 1, 0)
    return float((np.cross(a, b) * c).sum())


@kernel
def _match_around(angles: Floats, solid_ends: Bools, begins: Ints, counts: Ints, same: float, partner: Indices) -> None:
    """Pair each face where a solid begins, counterclockwise, with the face where that solid ends.

    Write the pairs to `partner` (k,). At equal angles, ends come before beginnings. Members of a group keep the order
    of the file. At equal angles the last face to begin is the first to end, so that each of several coincident sheets
    is paired with itself.
    """
    for group in range(len(begins)):
        begin, count = begins[group], counts[group]
        order = np.argsort(angles[begin : begin + count])
        gap, turn = 2 * np.pi - (angles[begin + order[-1]] - angles[begin + order[0]]), 0
        for i in range(1, count):
            step = angles[begin + order[i]] - angles[begin + order[i - 1]]
            if step > gap:
                gap, turn = step, i
        rank = np.zeros(count, np.int64)
        for i in range(1, count):
            item, before = order[(turn + i) % count], order[(turn + i - 1) % count]
            apart = (angles[begin + item] - angles[begin + before]) % (2 * np.pi)
            rank[item] = rank[before] + (same < apart < 2 * np.pi - same)
        keys = np.empty(count, np.int64)
        for item in range(count):
            ends = solid_ends[begin + item]
            keys[item] = (2 * rank[item] + (0 if ends else 1)) * count + (count - 1 - item if ends else item)
        order = np.argsort(keys)
        stack, top = np.empty(2 * count, np.int64), 0
        for i in range(2 * count):
            item = order[i % count]
            if not solid_ends[begin + item]:
                if i < count:
                    stack[top] = item
                    top += 1
            elif top > 0 and partner[begin + item] < 0:
                top -= 1
                partner[begin + item] = begin + stack[top]
