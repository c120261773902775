"""Minimal geodesics, as polylines on the surface."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from unbend.arrays import Floats, Ints
from unbend.errors import ParameterError, UnsuitedError
from unbend.geodesics.contours import without_repeats
from unbend.geodesics.distances import check_vertices, geodesic_distances
from unbend.geodesics.paths.search import crossings, search_shortest, straighten_walk
from unbend.geodesics.paths.strips import StripMesh, Work, path_arrays, strip_mesh, work_arrays
from unbend.mesh.surface import Surface

_SNAP: Final = 1e-12  # a crossing this near to an edge's end, as a share of the edge, counts as the vertex
_FIELD_ERROR: Final = 0.01  # a path longer than the marched distance by this share took the wrong side of an obstacle


def geodesic_path(surface: Surface, source: int, target: int) -> Floats:
    """Minimal geodesic from one vertex to another: a polyline that runs straight through the triangles.

    Several descents of the distance fields of both ends give paths, which are then made locally shortest. The shortest
    path is exact up to rounding if one of the descents passed every obstacle on the correct side.

    Parameters
    ----------
    surface : Surface
        Any triangulated surface; it need not be closed, manifold or oriented.
    source, target : int
        Vertex indices.

    Returns
    -------
    (p, 3) float64
        Points from `source` to `target`; each segment lies in one triangle. A single point if both are the same.

    Raises
    ------
    ParameterError
        If `source` or `target` is not a vertex.
    UnsuitedError
        If no path connects the two vertices.

    Examples
    --------
    >>> from unbend.mesh.shapes import sphere
    >>> path = geodesic_path(sphere(), 0, 1)
    >>> path.shape[1]
    3
    """
    ends = np.array([_one_vertex(surface, source, "source"), _one_vertex(surface, target, "target")], np.int64)
    if ends[0] == ends[1]:
        return surface.vertices[ends[:1]]
    fields = np.array(geodesic_distances(surface, ends), np.float64)
    reached = min(fields[0, ends[1]], fields[1, ends[0]])
    if not np.isfinite(reached):
        raise UnsuitedError(f"target: no path leads from vertex {source} to vertex {target}, on another component")
    mesh = strip_mesh(surface)
    buffers = path_arrays(mesh), path_arrays(mesh), path_arrays(mesh), work_arrays(mesh)
    there = _polyline(surface, mesh, buffers[3], search_shortest(mesh, fields[1], ends[1], ends[0], *buffers))
    back = _polyline(surface, mesh, buffers[3], search_shortest(mesh, fields[0], ends[0], ends[1], *buffers))
    best = min(there, back[::-1], key=_length)
    if not _length(best) <= reached * (1 + _FIELD_ERROR):
        walk = _along_edges(surface, int(ends[0]), int(ends[1]))
        straight = _polyline(surface, mesh, buffers[3], straighten_walk(mesh, walk, buffers[0], buffers[1], buffers[3]))
        best = min(best, _between_ends(surface.vertices[walk]), straight, key=_length)
    return best


def _polyline(surface: Surface, mesh: StripMesh, work: Work, path: tuple[Any, Any, int]) -> Floats:
    """Return the points of a path, (0, 3) if it has no pieces."""
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
    """Drop repeated points, but keep both ends, even if they coincide."""
    points = without_repeats(points)
    return points if len(points) > 1 else np.repeat(points, 2, axis=0)


def _along_edges(surface: Surface, source: int, target: int) -> Ints:
    """Return the vertices of a shortest path along edges."""
    count = len(surface.vertices)
    sides = np.sort(surface.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1).astype(np.int64)
    tails, heads = np.divmod(np.unique(sides[:, 0] * count + sides[:, 1]), count)
    lengths = np.linalg.norm(surface.vertices[tails] - surface.vertices[heads], axis=1)
    weights = np.maximum(lengths, np.finfo(float).tiny)  # SciPy treats 0 as no edge
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
