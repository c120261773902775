"""Stitching of seams. At a seam a file has an edge twice, between copies of its vertices."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from unbend.arrays import Bools, Floats, Indices, Ints
from unbend.jit import kernel
from unbend.mesh.clean import find_repeats
from unbend.mesh.components import join, root
from unbend.mesh.pairing import Joins, Rims, corners_of, joins_between
from unbend.mesh.surface import Surface
from unbend.mesh.topology import find_edges
from unbend.tolerances import SEAM_EDGES, SEAM_GAP

_CAREFUL_ROUNDS: Final = 16  # rounds that undo few joins at each invalid edge; later rounds undo all joins there


@dataclass(frozen=True, eq=False)
class _Seams:
    """Joins, and for each vertex the lowest vertex that is joined with it, (n,) int32."""

    joins: Joins
    into: Ints


@dataclass(frozen=True, eq=False)
class _InvalidEdges:
    """The half-edges of invalid edges: their ends, (k, 2), and the ascending number of the edge of each, (k,)."""

    ends: Ints
    edge: Indices


def stitched(surface: Surface, places: Ints) -> Surface:
    """Join pairs of boundary edges of `surface` whose ends coincide, and merge the copies of their vertices.

    `places` has for each vertex the first vertex with the same coordinates, (n,) int32. First, edges of opposite
    directions with equal ends are joined, then edges of opposite directions whose ends differ in the last digits, and
    last, edges of faces with different orientations. A join never makes an edge of more than two faces, except in a
    soup. The faces of a soup share no edge, so nothing shows which of them belong together. Vertices that touch without
    a joined edge stay separate.

    The result keeps the lowest copy of each vertex, in the same order. `vertex_map` maps each vertex to that copy. It
    is None if nothing was joined.
    """
    if surface.edges.boundary == 0:
        return surface
    soup = surface.edges.boundary == 3 * len(surface.faces)
    whole, surface = surface, _without_loose_repeats(surface, places, soup)
    nothing = _Seams(Joins.none(), np.arange(len(places), dtype=np.int32))
    seams = _joining(nothing, surface, places, soup)
    near = _near_places(surface, _left(surface, seams), places)
    if near is not places:
        if soup:  # with the new places, more faces may repeat each other: start again without them
            surface, seams = _without_loose_repeats(surface, near, soup), nothing
        seams = _joining(seams, surface, near, soup)
    if not soup:
        seams = _joining(seams, surface, near, soup, misoriented=True)
    into = _with_dropped_corners(seams.into, whole, surface, near)
    gap = SEAM_GAP * surface.extent if (places[into] != places).any() else None
    report = surface.report.adding(seams=len(seams.joins), seam_tolerance=gap)
    return _compact(surface.with_report(report), into)


def _without_loose_repeats(surface: Surface, places: Ints, soup: bool) -> Surface:
    """Drop faces that share no edge and repeat a place; in a soup, also faces at the places of an earlier face."""
    loose = np.flatnonzero(_loose(surface))
    twice, again = find_repeats(places[surface.faces[loose]], len(places))
    dropped = twice | again if soup else twice
    if not dropped.any():
        return surface
    report = surface.report
    report = report.adding(
        degenerate_faces=report.degenerate_faces + int(twice.sum()),
        duplicate_faces=report.duplicate_faces + (int(again.sum()) if soup else 0),
    )
    return Surface(surface.vertices, np.delete(surface.faces, loose[dropped], axis=0), report)


def _loose(surface: Surface) -> Bools:
    """Return a mask of the faces that share no edge with another, (m,)."""
    rims = np.zeros(3 * len(surface.faces), bool)
    rims[Rims.of(surface).half_edge] = True
    loose: Bools = np.logical_and.reduce(rims.reshape(-1, 3), axis=1)
    return loose


def _left(surface: Surface, seams: _Seams) -> Rims:
    """Return the boundary half-edges that are not joined."""
    return Rims.of(surface).without(seams.joins)


def _joining(seams: _Seams, surface: Surface, places: Ints, soup: bool, *, misoriented: bool = False) -> _Seams:
    """Return `seams` with all further joins that `places` allow and that leave no edge invalid."""
    new = joins_between(surface, _left(surface, seams), places, soup=soup, misoriented=misoriented)
    careful_rounds = _CAREFUL_ROUNDS
    while len(new):
        joins, into = seams.joins.followed_by(new), np.arange(len(places), dtype=np.int32)
        _unite(joins.ends, into)
        invalid = None if soup else _invalid_edges(surface.faces, into)
        if invalid is None or len(invalid.ends) == 0:
            return _Seams(joins, into)
        new = new.where(~_joins_to_undo(new, invalid, into, careful=careful_rounds > 0))
        careful_rounds -= 1
    return seams


def _joins_to_undo(joins: Joins, invalid: _InvalidEdges, into: Ints, careful: bool) -> Bools:
    """Return a mask of the `joins` to undo, (k,).

    If `careful`, undo at each invalid edge only the joins at the end with the fewest joins, otherwise the joins at all
    ends. If no end of an invalid edge has a join, undo the joins at the other copies of the ends.
    """
    ends, marked = joins.ends.reshape(-1, 4), np.zeros(len(into), bool)
    if careful:
        has = np.bincount(ends.ravel(), minlength=len(into))
        candidates, edge = invalid.ends.ravel(), np.repeat(invalid.edge, 2)
        candidates, edge = candidates[has[candidates] > 0], edge[has[candidates] > 0]
        order = np.lexsort((candidates, has[candidates], edge))
        first = np.diff(edge[order], prepend=-1) > 0
        marked[candidates[order[first]]] = True
    else:
        marked[invalid.ends] = True
    touching: Bools = np.logical_or.reduce(marked[ends], axis=1)
    if not touching.any():
        marked[into[invalid.ends]] = True
        touching = np.logical_or.reduce(marked[into[ends]], axis=1)
    return touching


def _invalid_edges(faces: Ints, into: Ints) -> _InvalidEdges:
    """Return the edges that `into` contracts to a point, or to which it gives more than two faces."""
    merged = into[faces]
    edges = find_edges(merged, len(into))
    suspect = edges.order[np.repeat(edges.counts > 2, edges.counts)]
    if len(short := np.flatnonzero(np.roll(merged, -1, axis=1) == np.roll(merged, -2, axis=1))):
        suspect = np.union1d(suspect, short.astype(np.int32))
    ends = np.stack(corners_of(faces.ravel(), suspect)[:2], axis=1)
    keys, old = _edge_keys(into[ends], len(into)), _edge_keys(ends, len(into))
    order = np.argsort(keys)
    ends, keys, old = ends[order], keys[order], old[order]
    starts = np.flatnonzero(np.diff(keys, prepend=-1))
    counts = np.diff(starts, append=len(keys))
    several = np.minimum.reduceat(old, starts) != np.maximum.reduceat(old, starts) if len(starts) else starts > 0
    vanished = into[ends[:, 0]] == into[ends[:, 1]]
    chosen = np.repeat(several & (counts > 2), counts) | vanished
    return _InvalidEdges(ends[chosen], np.repeat(np.arange(len(starts)), counts)[chosen])


def _edge_keys(ends: Ints, count: int) -> Indices:
    keys: Indices = ends.min(axis=1).astype(np.int64) * count + ends.max(axis=1)
    return keys


def _near_places(surface: Surface, rims: Rims, places: Ints) -> Ints:
    """Return `places` after merging places on the rims that are within the tolerance of each other."""
    tolerance = SEAM_GAP * surface.extent
    on_rims = np.zeros(len(places), bool)
    on_rims[places[rims.tail]] = on_rims[places[rims.head]] = True
    ends = np.flatnonzero(on_rims)
    ends = ends[_shortest_edges(surface, ends, places) >= SEAM_EDGES * tolerance]
    if len(ends) < 2:
        return places
    points = (surface.vertices[ends] - surface.vertices[ends].min(axis=0)) / tolerance
    # All points in a cell are near each other. Only the first point of a cell searches for pairs, so that dense cells
    # create few pairs.
    cells = np.floor(points * 3**0.5).astype(np.int64) @ (1 << np.array([0, 21, 42]))
    _, first, cell = np.unique(cells, return_index=True, return_inverse=True)
    pairs = first[cKDTree(points[first]).query_pairs(1.0, output_type="ndarray")]
    if len(first) == len(ends) and len(pairs) == 0:
        return places
    into = np.arange(len(places), dtype=np.int32)
    within = np.stack([np.arange(len(ends)), first[cell]], axis=1)
    _unite(ends[np.concatenate([within, pairs])].astype(np.int32)[:, None], into)
    # Cells may form long chains. A point farther than half the tolerance from the first of its chain stays separate.
    apart = (surface.vertices[ends] - surface.vertices[into[ends]]) / tolerance
    alone = ends[(apart**2).sum(axis=1) > 0.25]
    into[alone] = alone
    near: Ints = into[places]
    return near


def _shortest_edges(surface: Surface, ends: Indices, places: Ints) -> Floats:
    """Return the length of the shortest edge from each place in `ends` to another place, (k,)."""
    wanted = np.zeros(len(places), bool)
    wanted[ends] = True
    corners = places[surface.faces]
    corners = corners[wanted[corners].any(axis=1)]
    following = np.roll(corners, -1, axis=1)
    steps = (surface.vertices[following] - surface.vertices[corners]) / surface.scale
    lengths = np.sqrt((steps**2).sum(axis=2)) * surface.scale
    lengths[corners == following] = np.inf
    shortest = np.full(len(places), np.inf)
    np.minimum.at(shortest, corners, lengths)
    np.minimum.at(shortest, following, lengths)
    chosen: Floats = shortest[ends]
    return chosen


def _with_dropped_corners(into: Ints, whole: Surface, surface: Surface, places: Ints) -> Ints:
    """Return `into` after mapping the corners of dropped faces to a used vertex at the same place, if there is one."""
    lost = np.setdiff1d(whole.used_vertices, surface.used_vertices, assume_unique=True)
    if len(lost) == 0:
        return into
    at_place = np.full(len(places), -1, np.int32)
    used = surface.used_vertices[::-1]  # the last assignment wins, which is the lowest vertex
    at_place[places[used]] = used
    found, into = at_place[places[lost]], into.copy()
    _unite(np.stack([lost, found], axis=1).astype(np.int32)[found >= 0][:, None], into)
    return into


def _compact(surface: Surface, into: Ints) -> Surface:
    kept = into == np.arange(len(into))
    if kept.all():
        return surface
    vertex_map = (np.cumsum(kept) - 1)[into]
    return Surface(surface.vertices[kept], vertex_map[surface.faces], surface.report, vertex_map)


@kernel
def _unite(ends: Ints, into: Ints) -> None:
    """Join the pairs of vertices `ends` (k, e, 2), so that `into` (n,) has the lowest vertex of each set."""
    for i in range(len(ends)):
        for end in range(ends.shape[1]):
            join(into, ends[i, end, 0], ends[i, end, 1])
    for vertex in range(len(into)):
        into[vertex] = root(into, vertex)
