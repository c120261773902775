"""Minimal geodesics: polylines on the surface, and their lengths."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from unbend.arrays import Floats, Ints
from unbend.errors import ParameterError, UnsuitedError
from unbend.geodesics.distances import check_vertices, geodesic_distances
from unbend.geodesics.paths.search import crossings, refine, search_shortest, straighten_walk
from unbend.geodesics.paths.strips import StripMesh, Work, path_arrays, strip_mesh, work_arrays
from unbend.geodesics.polylines import without_repeats
from unbend.mesh.surface import Surface

_SNAP: Final = 1e-12  # a path that crosses an edge as near to its end, in units of the edge, goes through the vertex
_FIELD_ERROR: Final = 0.01  # marching never takes a longer way than edges: a path this much above it went wrong


def geodesic_path(surface: Surface, source: int, target: int) -> Floats:
    """Minimal geodesic from one vertex to another: a polyline that runs straight through the triangles.

    Walks down the distance fields of both ends give paths, which are made locally shortest; the shortest of them is
    exact up to rounding if one of the walks went the right way round everything between the ends.

    Parameters
    ----------
    surface : Surface
        Any triangulated surface; it need not be closed, manifold or oriented.
    source, target : int
        Vertex indices.

    Returns
    -------
    (p, 3) float64
        From `source` to `target`; each segment lies in one triangle. A single point, p = 1, if they are the same.

    Raises
    ------
    ParameterError
        If `source` or `target` is not a vertex; UnsuitedError if no path joins them.
    """
    ends = np.array([_one_vertex(surface, source, "source"), _one_vertex(surface, target, "target")], np.int64)
    if ends[0] == ends[1]:
        return surface.vertices[ends[:1]]
    fields = np.array(geodesic_distances(surface, ends), np.float64)
    reached = min(fields[0, ends[1]], fields[1, ends[0]])
    if not np.isfinite(reached):
        raise UnsuitedError(f"target: no path leads from vertex {source} to vertex {target}, on another component")
    mesh = strip_mesh(surface)
    room = path_arrays(mesh), path_arrays(mesh), path_arrays(mesh), work_arrays(mesh)
    there = _polyline(surface, mesh, room[3], search_shortest(mesh, fields[1], ends[1], ends[0], *room))
    back = _polyline(surface, mesh, room[3], search_shortest(mesh, fields[0], ends[0], ends[1], *room))
    best = min(there, back[::-1], key=_length)
    if not _length(best) <= reached * (1 + _FIELD_ERROR):
        walk = _along_edges(surface, int(ends[0]), int(ends[1]))
        straight = _polyline(surface, mesh, room[3], straighten_walk(mesh, walk, room[0], room[1], room[3]))
        best = min(best, _between_ends(surface.vertices[walk]), straight, key=_length)
    return best


def path_lengths(mesh: StripMesh, field: Floats, source: int, targets: Ints) -> Floats:
    """Lengths of locally shortest paths from one vertex to others, found by walks down its distance field.

    A walk has only to go the right way round what lies between, so the lengths are much nearer to the exact
    distances than the field is, and never below them.

    Parameters
    ----------
    mesh : StripMesh
        From `strip_mesh`.
    field : (n,) float
        Distances from `source`, as `geodesic_distances` gives them.
    source : int
    targets : (t,) int

    Returns
    -------
    (t,) float64
        inf where the field is; the field's own value where no walk arrives, which can be only behind faces that
        repeat a vertex.
    """
    field, targets = np.array(field), np.asarray(targets, np.int64)
    order = np.argsort(field[targets], kind="stable")
    sorted_lengths = np.empty(len(targets))
    room = path_arrays(mesh), path_arrays(mesh), work_arrays(mesh)
    refine(mesh, field, np.int64(source), targets[order], sorted_lengths, *room)
    lengths = np.empty(len(targets))
    lengths[order] = sorted_lengths
    return lengths


def _polyline(surface: Surface, mesh: StripMesh, work: Work, path: tuple[Any, Any, int]) -> Floats:
    """Return the points of a path, none if it has no pieces."""
    pieces, portals, count = path
    if count == 0:
        return np.empty((0, 3))
    first = np.empty(pieces["start"][count] + count + 1, np.int64)
    second, share = np.empty_like(first), np.empty(len(first))
    crossings(mesh.half_edges, pieces, portals, count, work.points, work.ends, work.deque, first, second, share)
    share = np.where(share < _SNAP, 0.0, share)[:, None]
    start, end = surface.vertices[first], surface.vertices[second]
    return _between_ends(np.where(share > 1 - _SNAP, end, start + share * (end - start)))


def _between_ends(points: Floats) -> Floats:
    """Leave out repeated points; both ends stay, even where they coincide."""
    points = without_repeats(points)
    return points if len(points) > 1 else np.repeat(points, 2, axis=0)


def _along_edges(surface: Surface, source: int, target: int) -> Ints:
    """Return the vertices of a shortest path along edges."""
    count = len(surface.vertices)
    sides = np.sort(surface.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1).astype(np.int64)
    tails, heads = np.divmod(np.unique(sides[:, 0] * count + sides[:, 1]), count)
    lengths = np.linalg.norm(surface.vertices[tails] - surface.vertices[heads], axis=1)
    weights = np.maximum(lengths, np.finfo(float).tiny)  # for SciPy, 0 is no edge
    graph = coo_array((weights, (tails, heads)), shape=(count, count)).tocsr()
    _, before = dijkstra(graph, directed=False, indices=[source], return_predecessors=True)
    path = [target]
    while path[-1] != source:
        path.append(int(before[0, path[-1]]))
    return np.array(path[::-1])


def _length(polyline: Floats) -> float:
    steps = np.linalg.norm(np.diff(polyline, axis=0), axis=1)
    return float(steps.sum()) if len(polyline) else np.inf


def _one_vertex(surface: Surface, index: int, what: str) -> int:
    vertices = check_vertices(surface, index, what)
    if len(vertices) != 1:
        raise ParameterError(f"{what} must be one vertex index, not {len(vertices)}")
    return int(vertices[0])
