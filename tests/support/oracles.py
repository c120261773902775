"""Reference results: exact polyhedral geodesics, and errors relative to them."""

from __future__ import annotations

import numba
import numpy as np
import pygeodesic.geodesic as exact_geodesics
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from unbend import Surface


def exact_distances(surface: Surface, sources: np.ndarray) -> np.ndarray:
    """Return exact geodesic distances (Mitchell, Mount, Papadimitriou) on a manifold surface, (k, n)."""
    algorithm = exact_geodesics.PyGeodesicAlgorithmExact(surface.vertices, surface.faces)
    return np.array([algorithm.geodesicDistances(np.array([source]))[0] for source in sources])


def mean_relative_error(distances: np.ndarray, exact: np.ndarray) -> float:
    """Return the mean of |d - exact| / exact over all pairs with a positive exact distance."""
    known = exact > 0
    return float((np.abs(distances - exact)[known] / exact[known]).mean())


def grid(columns: int, rows: int, shear: float = 0.0) -> Surface:
    """Return a flat grid of unit cells, each of two triangles, sheared by x += shear y."""
    x, y = np.meshgrid(np.arange(columns + 1.0), np.arange(rows + 1.0))
    vertices = np.stack([x + shear * y, y, 0 * x], axis=-1).reshape(-1, 3)
    corner = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    right, up, both = corner + 1, corner + columns + 1, corner + columns + 2
    faces = np.concatenate([np.stack([corner, right, both], 1), np.stack([corner, both, up], 1)])
    return Surface(vertices, faces)


def edge_path_distances(surface: Surface, sources: np.ndarray) -> np.ndarray:
    """Return the lengths of shortest paths along edges, (k, n); inf if there is no path."""
    return steiner_distances(surface, sources, points=0)


def steiner_distances(surface: Surface, sources: np.ndarray, points: int = 8) -> np.ndarray:
    """Return the lengths of shortest paths over lines between points on edges, (k, n), on any triangle soup.

    The lengths are upper bounds, which converge to exact distances with more points, but slowly on needles.
    """
    places = _unit_places(surface)
    sides, faces = _sides_of_faces(surface)
    # Each node has a vertex and an offset from it, because coordinates far from the origin would round its place.
    share = np.arange(1, points + 1)[:, None] / (points + 1)
    along = (places[sides[:, 1]] - places[sides[:, 0]])[:, None] * share
    near = np.concatenate([places, np.repeat(places[sides[:, 0]], points, axis=0)])
    offset = np.concatenate([np.zeros(places.shape), along.reshape(-1, 3)])
    inner = len(places) + np.arange(len(sides) * points).reshape(len(sides), points)
    chains = np.concatenate([sides[:, :1], inner, sides[:, 1:]], axis=1)
    first, second = [chains[:, :-1].ravel()], [chains[:, 1:].ravel()]
    for one, other in ((0, 1), (1, 2), (2, 0)) if points else ():
        first.append(np.repeat(inner[faces[:, one]], points, axis=1).ravel())
        second.append(np.tile(inner[faces[:, other]], points).ravel())
    for corner in range(3) if points else ():  # sides are opposite corners
        first.append(np.repeat(surface.faces[:, corner], points))
        second.append(inner[faces[:, corner]].ravel())
    a, b = np.concatenate(first), np.concatenate(second)
    # A sparse graph treats zeros as missing edges.
    steps = (near[a] - near[b]) + (offset[a] - offset[b])
    lengths = np.maximum(np.linalg.norm(steps, axis=1), np.finfo(float).tiny)
    count = len(near)
    pairs, kept = np.unique(np.minimum(a, b) * count + np.maximum(a, b), return_index=True)
    graph = csr_array((lengths[kept], (pairs // count, pairs % count)), (count, count))
    return dijkstra(graph, directed=False, indices=sources)[:, : len(places)] * surface.scale


class TooManyWindowsError(Exception):
    """Faces of zero area multiplied the windows beyond the limit of the exact oracle."""


def soup_distances(surface: Surface, sources: np.ndarray) -> np.ndarray:
    """Return exact geodesic distances, (k, n), on any small triangle soup.

    From every vertex, windows (Mitchell, Mount, Papadimitriou) propagate along straight lines through strips of
    triangles, and branch at edges of more than two triangles. A window is dropped if a path over an end of its edge
    is shorter (Xin & Wang 2009); distances along edges are the first bounds for this test.
    """
    places = _unit_places(surface)
    sides, of_faces = _sides_of_faces(surface)
    order = np.argsort(of_faces.ravel(), kind="stable")
    starts = np.searchsorted(of_faces.ravel()[order], np.arange(len(sides) + 1))
    distances = edge_path_distances(surface, sources) / surface.scale
    windows = np.empty((100_000, 10))
    for row in distances:
        if not _settle(places, surface.faces, of_faces, starts, order, row, windows):
            raise TooManyWindowsError
    return distances * surface.scale


def _unit_places(surface: Surface) -> np.ndarray:
    """Return coordinates in units of the scale, and zero for unused vertices.

    The surface is not moved to the origin: that would round away parts far smaller than the extent of the surface.
    """
    places = np.zeros(surface.vertices.shape)
    used = surface.used_vertices
    places[used] = surface.vertices[used] / surface.scale
    return places


def _sides_of_faces(surface: Surface) -> tuple[np.ndarray, np.ndarray]:
    """Return the ends of all edges, (e, 2), and the edge opposite each corner, (m, 3)."""
    ends = np.sort(surface.faces[:, [[1, 2], [2, 0], [0, 1]]].reshape(-1, 2).astype(np.int64), axis=1)
    sides, of_faces = np.unique(ends, axis=0, return_inverse=True)
    return sides, of_faces.reshape(-1, 3)


@numba.njit(cache=True)
def _settle(places, faces, of_faces, starts, order, distances, windows):
    """Lower `distances` until no vertex sees a shorter path to another; return false if there are too many windows."""
    pending = np.isfinite(distances)
    for _ in range(50 * len(places)):
        root = -1
        for vertex in range(len(places)):
            if pending[vertex] and (root < 0 or distances[vertex] < distances[root]):
                root = vertex
        if root < 0:
            return True
        pending[root] = False
        if not _look_around(places, faces, of_faces, starts, order, distances, windows, root, pending):
            return False
    return False


@numba.njit(cache=True)
def _look_around(places, faces, of_faces, starts, order, distances, windows, root, pending):  # noqa: C901, PLR0912, PLR0915
    """Unfold all strips of triangles from `root`, and lower the distances of vertices visible from it.

    A window has a face, the corner opposite its edge, the visible interval of the edge, the position of the source,
    and the number of triangles so far. In its frame, the edge is on the x axis and starts at its end of lower number.
    """
    size = seen = 0
    for face in range(len(faces)):
        for corner in range(3):
            if faces[face, corner] == root:
                a, b = _ends(faces, face, corner)
                edge = places[b] - places[a]
                length = np.sqrt((edge**2).sum())
                for end in (a, b):
                    along = distances[root] + np.sqrt(((places[end] - places[root]) ** 2).sum())
                    if along < distances[end] * (1 - 1e-14):
                        distances[end], pending[end] = along, True
                if length > 0.0:
                    x, y = _in_frame(places[root] - places[a], edge / length)
                    size = _push(windows, size, face, corner, 0.0, length, x, y, 0)
    while size > 0:
        size -= 1
        seen += 1
        if seen > 300_000:  # windows multiply around faces of zero area
            return False
        face, corner, depth = int(windows[size, 0]), int(windows[size, 1]), int(windows[size, 6])
        low, high, x, y = windows[size, 2], windows[size, 3], windows[size, 4], windows[size, 5]
        a, b = _ends(faces, face, corner)
        edge = places[b] - places[a]
        length = np.sqrt((edge**2).sum())
        y = max(y, 1e-10 * length)  # in a triangle of zero area, the source is on the edge
        behind = distances[root]
        if behind + np.hypot(x - high, y) >= distances[a] + high:
            continue
        if behind + np.hypot(x - low, y) >= distances[b] + length - low:
            continue
        side = of_faces[face, corner]
        for index in range(starts[side], starts[side + 1]):
            other, opposite = order[index] // 3, order[index] % 3
            if other == face:
                continue
            c = faces[other, opposite]
            cx, cy = _in_frame(places[c] - places[a], edge / length)
            at = (x * cy + cx * y) / (y + cy)  # where the line to C crosses the edge
            straight = np.hypot(cx - x, cy + y)
            if low <= at <= high and behind + straight < distances[c] * (1 - 1e-14):
                distances[c], pending[c] = behind + straight, True
            if depth + 1 >= len(faces):
                continue
            if size + 2 > len(windows):
                return False
            if low < at:  # continue to the edge from A to C
                base = np.hypot(cx, cy)
                if base > 0.0:
                    first, last = _cross(low, x, y, cx, cy), (1.0 if high >= at else _cross(high, x, y, cx, cy))
                    nx, ny = (x * cx - y * cy) / base, (cx * y + cy * x) / base
                    size = _push_turned(windows, size, faces, other, a, c, first, last, base, nx, ny, depth)
            if high > at:  # continue to the edge from B to C, in the frame of B
                base = np.hypot(length - cx, cy)
                if base > 0.0:
                    bx, px = length - cx, length - x
                    first = _cross(length - high, px, y, bx, cy)
                    last = 1.0 if low <= at else _cross(length - low, px, y, bx, cy)
                    nx, ny = (px * bx - y * cy) / base, (bx * y + cy * px) / base
                    size = _push_turned(windows, size, faces, other, b, c, first, last, base, nx, ny, depth)
    return True


@numba.njit(cache=True)
def _ends(faces, face, corner):
    a, b = faces[face, (corner + 1) % 3], faces[face, (corner + 2) % 3]
    return min(a, b), max(a, b)


@numba.njit(cache=True)
def _in_frame(offset, unit):
    along = (offset * unit).sum()
    return along, np.sqrt(((offset - along * unit) ** 2).sum())


@numba.njit(cache=True)
def _cross(at, x, y, cx, cy):
    """Return the share of the edge from (0, 0) to (cx, -cy) at which the ray from (x, y) over (at, 0) meets it."""
    below = y * cx - (at - x) * cy
    return min(1.0, max(0.0, at * y / below)) if below > 0.0 else 1.0


@numba.njit(cache=True)
def _push(windows, size, face, corner, low, high, x, y, depth):
    windows[size, 0], windows[size, 1], windows[size, 2], windows[size, 3] = face, corner, low, high
    windows[size, 4], windows[size, 5], windows[size, 6] = x, y, depth
    return size + 1


@numba.njit(cache=True)
def _push_turned(windows, size, faces, face, a, c, first, last, base, x, y, depth):
    """Push the window from share `first` to `last` of the edge from A to C, seen from (x, y) in A's frame."""
    for corner in range(3):
        if faces[face, corner] != a and faces[face, corner] != c:
            if a < c:
                return _push(windows, size, face, corner, first * base, last * base, x, y, depth + 1)
            return _push(windows, size, face, corner, (1 - last) * base, (1 - first) * base, base - x, y, depth + 1)
    return size
