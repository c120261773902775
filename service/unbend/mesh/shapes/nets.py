"""Polygonisation of the zero set of a function on a grid, by surface nets with a vertex for each sheet of a cell.

The net has a quad for each crossed grid edge, and a vertex in each cell that the surface crosses (Gibson 1998,
"Constrained elastic surface nets"), or several vertices if several sheets pass through the cell (Nielson 2004, "Dual
marching cubes"). Then the net is relaxed along the surface and moved onto it by Newton steps.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from itertools import product

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from unbend.arrays import Floats, Indices, frozen
from unbend.mesh.shapes.grids import split_quads

Gradient = Callable[[Floats], tuple[Floats, Floats]]

CORNERS = np.array(list(product((0, 1), repeat=3)))
"""Corners of a cell, (8, 3); corner number 4 i + 2 j + k is at (i, j, k)."""

EDGES = np.array([(a, a + step) for step in (1, 2, 4) for a in range(8) if not a & step])
"""The twelve edges of a cell as pairs of corner numbers, (12, 2)."""

FACES = tuple((a, a + i, a + i + j, a + j) for i, j in ((1, 2), (2, 4), (4, 1)) for a in (0, 7 - i - j))
"""The corners of each face of a cell, in their order around the face."""


def surface_net(values: Floats, origin: Floats, cell: float) -> tuple[Floats, Indices]:
    """Return vertices (n, 3) and quads (q, 4) of the zero set of gridded values.

    Parameters
    ----------
    values : (i, j, k)
        Samples, negative inside. They must be positive on the border of the grid, so that the net is closed.
    origin : (3,)
        Position of values[0, 0, 0].
    cell : float
        Distance between grid points.

    Returns
    -------
    vertices, quads
        The quads turn counter-clockwise seen from outside.
    """
    inside = values < 0
    bits = sum(inside[_corner(values.shape, c)].astype(np.int64) << k for k, c in enumerate(CORNERS))
    case = np.asarray(bits)
    cells = np.argwhere((case > 0) & (case < 255))  # (n, 3)
    sheet = _sheets()[case[tuple(cells.T)]]  # (n, 12)
    first = np.concatenate([[0], np.cumsum(sheet.max(axis=1) + 1)])  # number of each cell's first vertex
    vertex = np.where(sheet >= 0, first[:-1, None] + sheet, -1)  # (n, 12)
    vertices = origin + cell * _means(values, cells, vertex, int(first[-1]))
    row = np.full(case.shape, -1, np.int64)
    row[tuple(cells.T)] = np.arange(len(cells))
    return vertices, np.concatenate([_quads(inside, row, vertex, axis) for axis in range(3)])


def relaxed(vertices: Floats, quads: Indices, gradient: Gradient, cell: float, *, rounds: int = 6) -> Floats:
    """Move the vertices halfway to the mean of their neighbours and back onto the surface, `rounds` times."""
    rows, columns = quads.ravel(), np.roll(quads, -1, axis=1).ravel()
    ones = np.ones(len(rows))
    # Half of an edge's quads traverse it in each direction. Neighbours therefore count once, or twice if the edge has
    # four quads instead of two, which is rare.
    neighbours = coo_array((ones, (rows, columns)), shape=(len(vertices),) * 2).tocsr()
    degree: Floats = np.asarray(neighbours.sum(axis=1)).ravel()[:, None]
    vertices = _projected(vertices, gradient, cell, steps=2)
    for _ in range(rounds):
        vertices = _projected((vertices + np.asarray(neighbours @ vertices) / degree) / 2, gradient, cell, steps=1)
    return _projected(vertices, gradient, cell, steps=3)


def triangulated(vertices: Floats, quads: Indices) -> Indices:
    """Split quads (q, 4) along their shorter diagonals into triangles (2 q, 3)."""
    corners = vertices[quads]
    first = np.linalg.norm(corners[:, 0] - corners[:, 2], axis=1)
    second = np.linalg.norm(corners[:, 1] - corners[:, 3], axis=1)
    return split_quads(quads, second < first)


def largest_component(vertices: Floats, quads: Indices) -> tuple[Floats, Indices, int]:
    """Return the component with the most vertices, renumbered, and the number of components that are solids.

    A component that encloses a negative volume is not a solid but the wall of a hollow inside another component.
    """
    rows, columns = quads[:, :3].ravel(), quads[:, 1:].ravel()
    graph = coo_array((np.ones(len(rows), np.int8), (rows, columns)), shape=(len(vertices),) * 2)
    label = connected_components(graph, directed=False)[1]
    a, b, c, d = (vertices[quads[:, corner]] for corner in range(4))
    volumes = np.bincount(label[quads[:, 0]], np.einsum("ij,ij->i", a, np.cross(b, c) + np.cross(c, d)))
    kept = label == np.bincount(label).argmax()
    number = np.cumsum(kept) - 1
    return vertices[kept], number[quads[kept[quads[:, 0]]]], int((volumes > 0).sum())


def _corner(shape: tuple[int, ...], corner: Indices) -> tuple[slice, ...]:
    """Return the slice of a grid that contains one corner of every cell."""
    return tuple(slice(int(c), size - 1 + int(c)) for c, size in zip(corner, shape, strict=True))


@cache
def _sheets() -> Indices:
    """Return the number of the sheet that crosses each edge of a cell, (256, 12), -1 for none.

    Bit k of the row's index says whether corner k is inside. Two crossings are on one sheet if a face connects them. On
    a face with four crossings, each inside corner is cut off separately, so that near parts stay apart.
    """
    edge = {frozenset(map(int, ends)): number for number, ends in enumerate(EDGES)}
    table = np.full((256, 12), -1, np.int64)
    for case in range(256):
        joined: list[tuple[int, int]] = []
        for corners in FACES:
            inside = [bool(case >> corner & 1) for corner in corners]
            sides = [edge[frozenset((corners[k], corners[(k + 1) % 4]))] for k in range(4)]
            enters = [k for k in range(4) if not inside[k] and inside[(k + 1) % 4]]
            for k in enters:
                leave = next(m % 4 for m in range(k + 1, k + 4) if not inside[(m + 1) % 4])
                joined.append((sides[k], sides[leave]))
        used = sorted({side for pair in joined for side in pair})
        rows, columns = np.array(joined or [(0, 0)]).T
        graph = coo_array((np.ones(len(rows), np.int8), (rows, columns)), shape=(12, 12))
        label = connected_components(graph, directed=False)[1][used]
        table[case, used] = np.unique(label, return_inverse=True)[1]
    return frozen(table, np.int64)


def _means(values: Floats, cells: Indices, vertex: Indices, count: int) -> Floats:
    """Return the mean of the points where each vertex's edges cross zero, in grid units, (count, 3)."""
    corner = values[tuple((cells[:, None] + CORNERS).transpose(2, 0, 1))]  # (n, 8)
    row, edge = np.nonzero(vertex >= 0)
    start, end = EDGES[edge].T
    a, b = corner[row, start], corner[row, end]
    points = cells[row] + CORNERS[start] + (a / (a - b))[:, None] * (CORNERS[end] - CORNERS[start])
    owner = vertex[row, edge]
    sums = np.stack([np.bincount(owner, axis, minlength=count) for axis in points.T], axis=1)
    return np.asarray(sums / np.bincount(owner, minlength=count)[:, None], float)


def _quads(
    inside: np.ndarray[tuple[int, ...], np.dtype[np.bool_]], row: Indices, vertex: Indices, axis: int
) -> Indices:
    """Return a quad (q, 4) of the vertices in the four cells around every crossed grid edge along `axis`."""
    here = np.take(inside, range(inside.shape[axis] - 1), axis=axis)
    there = np.take(inside, range(1, inside.shape[axis]), axis=axis)
    edges = np.argwhere(here != there)
    along, side, up = np.roll(np.eye(3, dtype=np.int64), -axis, axis=0)  # right-handed
    around = []
    for offset in (side + up, up, 0 * up, side):
        # An edge that starts at grid point p is, in the cell at p - `offset`, the edge that starts at corner `offset`.
        start, end = np.array([offset, offset + along]) @ (4, 2, 1)
        number = int(np.flatnonzero((EDGES[:, 0] == start) & (EDGES[:, 1] == end))[0])
        around.append(vertex[row[tuple((edges - offset).T)], number])
    quads = np.stack(around, axis=1)
    leaving = here[tuple(edges.T)]  # from inside to outside along +axis: the outward normal is +axis
    return np.where(leaving[:, None], quads, quads[:, ::-1])


def _projected(vertices: Floats, gradient: Gradient, cell: float, *, steps: int) -> Floats:
    """Return the vertices after Newton steps p - f grad f / |grad f|^2 of at most half a cell."""
    for _ in range(steps):
        distance, slope = gradient(vertices)
        square = np.maximum(np.einsum("ij,ij->i", slope, slope), 0.05)  # the gradient may nearly vanish at a crease
        step = np.clip(distance / np.sqrt(square), -cell / 2, cell / 2) / np.sqrt(square)
        vertices = vertices - step[:, None] * slope
    return vertices
