"""The mesh as path searches use it, and the arrays of a path.

Half-edge `3 f + i` lies opposite corner `i` of face `f` (`mesh.topology`). A *portal* is an edge that a path crosses:
the half-edge by which the path leaves one face, and the half-edge by which it enters the next. A *strip* is the
sequence of faces that a list of portals connects. It can be unfolded into the plane face by face. A path is a list of
*pieces* between vertices, its *nodes*. Each piece runs along one edge or straight through a strip.

The mesh need not be oriented, because the vertices distinguish the two ends of a portal.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from unbend.arrays import Ints
from unbend.jit import kernel
from unbend.mesh.surface import Surface
from unbend.mesh.topology import find_edges

SHORTEST_PORTAL: Final = 1e-10
"""Paths do not cross edges below this share of the mesh's extent: unfolding over them loses too many digits."""

HALF_EDGE: Final = np.dtype(
    [
        ("corner", np.int64),  # the vertex opposite
        ("twin", np.int64),  # the next half-edge of the same edge, cyclically; -1 if no path can cross the edge
        ("after", np.int64),  # the half-edge of the same face opposite the first end
        ("before", np.int64),  # the half-edge of the same face opposite the second end
        ("length", np.float64),
        ("along", np.float64),  # coordinate of `corner` from the first end to the second, over `length`
        ("aside", np.float64),  # distance of `corner` from the line of the edge, over `length`
        ("angle", np.float64),  # angle at `corner`
    ]
)
PORTAL: Final = np.dtype([("exit", np.int64), ("entry", np.int64)])
PIECE: Final = np.dtype(
    [
        ("node", np.int64),  # the vertex where the piece starts; it ends at the node of the next piece
        ("start", np.int64),  # index of the first portal
        ("edge", np.int64),  # a half-edge of the edge that the piece runs along, -1 for a strip
        ("fresh", np.int64),  # 1 if the last round changed the piece
        ("length", np.float64),
        ("head", np.float64),  # angle at the start between the piece and the first end of the first portal's exit
        ("tail", np.float64),  # angle at the end between the piece and the first end of the last portal's entry
    ]
)
POINT: Final = np.dtype(  # a vertex of an unfolded strip
    [
        ("x", np.float64),
        ("y", np.float64),
        ("vertex", np.int64),
        ("first", np.int64),  # the first and the last portal with an end at this point
        ("last", np.int64),
        ("parent", np.int64),  # the previous point on the shortest path from the start to this point
    ]
)
ENDS: Final = np.dtype([("right", np.int64), ("left", np.int64)])  # the points at the ends of a portal


class StripMesh(NamedTuple):
    """Connectivity and intrinsic geometry of a surface, as arrays for kernels."""

    half_edges: NDArray[Any]  # (3 m,) of HALF_EDGE, lengths in units of `extent`
    offsets: Ints  # (n + 1,) int64: start of each vertex' entries in `corners`
    corners: Ints  # (3 m,) int64: the half-edges opposite each vertex, vertex by vertex
    extent: float


class Path(NamedTuple):
    """Buffers for a path: its `pieces`, with one more for the last node, and the `portals` of all pieces."""

    pieces: NDArray[Any]
    portals: NDArray[Any]


class Work(NamedTuple):
    """Scratch arrays for straightening."""

    strip: NDArray[Any]  # portals of the current strip
    points: NDArray[Any]  # the unfolded vertices of the strip, from the start
    ends: NDArray[Any]  # points at the ends of each portal
    deque: Ints  # the funnel, from its left end over its apex to its right end
    turns: Ints  # for each node of the path, the turn that shortens it


def strip_mesh(surface: Surface) -> StripMesh:
    """Prepare `surface` for paths: O(m log m) for m faces. Faces that repeat a vertex are dropped."""
    a, b, c = surface.faces.T
    faces = surface.faces[(a != b) & (b != c) & (c != a)]
    count = len(surface.vertices)
    extent = surface.extent or 1.0
    twins = find_edges(faces, count).twins() if len(faces) else np.empty(0, np.int64)
    half_edges = np.empty(3 * len(faces), HALF_EDGE)
    _fill(surface.vertices, faces, twins, extent, half_edges)
    offsets = np.zeros(count + 1, np.int64)
    np.cumsum(np.bincount(faces.ravel(), minlength=count), out=offsets[1:])
    return StripMesh(half_edges, offsets, _by_corner(half_edges, offsets), extent)


@kernel
def _edge(vertices, extent, a, b):
    """Return (b - a) / extent, exactly the negative of the vector from b to a."""
    return (
        (vertices[b, 0] - vertices[a, 0]) / extent,
        (vertices[b, 1] - vertices[a, 1]) / extent,
        (vertices[b, 2] - vertices[a, 2]) / extent,
    )


@kernel
def _fill(vertices, faces, twins, extent, half_edges):
    for number in range(3 * len(faces)):
        face, place = number // 3, number % 3
        record = half_edges[number]
        record.corner = faces[face, place]
        record.after, record.before = 3 * face + (place + 1) % 3, 3 * face + (place + 2) % 3
        first, second = faces[face, (place + 1) % 3], faces[face, (place + 2) % 3]
        ex, ey, ez = _edge(vertices, extent, first, second)
        ax, ay, az = _edge(vertices, extent, record.corner, first)
        bx, by, bz = _edge(vertices, extent, record.corner, second)
        squared = ex * ex + ey * ey + ez * ez
        twice_area = np.sqrt((ay * bz - az * by) ** 2 + (az * bx - ax * bz) ** 2 + (ax * by - ay * bx) ** 2)
        record.length = np.sqrt(squared)
        record.twin = twins[number] if record.length >= SHORTEST_PORTAL else -1
        record.along = -(ax * ex + ay * ey + az * ez) / squared if squared > 0.0 else 0.0
        record.aside = twice_area / squared if squared > 0.0 else 0.0
        record.angle = np.arctan2(twice_area, ax * bx + ay * by + az * bz)


@kernel
def _by_corner(half_edges, offsets):
    corners, places = np.empty(len(half_edges), np.int64), offsets.copy()
    for number in range(len(half_edges)):
        place = places[half_edges[number].corner]
        corners[place] = number
        places[half_edges[number].corner] = place + 1
    return corners


def path_arrays(mesh: StripMesh) -> Path:
    """Allocate buffers for a path. The operating system provides memory only for pages that are used."""
    size = 2 * len(mesh.corners) + 64  # a path with more portals than half-edges is useless
    return Path(np.empty(size, PIECE), np.empty(size, PORTAL))


def work_arrays(mesh: StripMesh) -> Work:
    """Allocate scratch arrays for `shorten`, large enough for a path of `path_arrays`."""
    size = 2 * len(mesh.corners) + 64
    return Work(
        np.empty(size, PORTAL), np.empty(size, POINT), np.empty(size, ENDS), np.empty(2 * size, np.int64),
        np.empty(size, np.int64),
    )  # fmt: skip
