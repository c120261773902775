"""Connectivity of regular grids, open or periodic."""

from __future__ import annotations

from typing import Literal

import numpy as np

from unbend.arrays import Floats, Indices

Triangulation = Literal["alternating", "uniform"]
TRIANGULATIONS: tuple[str, ...] = ("alternating", "uniform")


def grid_parameters(columns: int, rows: int) -> tuple[Floats, Floats]:
    """Return (u, v), each ((rows + 1) * (columns + 1),), from 0 to 1; u changes fastest."""
    v, u = np.meshgrid(np.linspace(0.0, 1.0, rows + 1), np.linspace(0.0, 1.0, columns + 1), indexing="ij")
    return u.ravel(), v.ravel()


def grid_quads(columns: int, rows: int, *, periodic: tuple[bool, bool] = (False, False)) -> Indices:
    """Return the corners of each cell, (columns * rows, 4), counter-clockwise in the (u, v) plane.

    `periodic` says whether u (columns) and v (rows) wrap around. A direction that wraps has as many vertices as cells;
    an open direction has one more vertex.
    """
    across, down = columns + (not periodic[0]), rows + (not periodic[1])
    row, column = (index.ravel() for index in np.indices((rows, columns)))
    corners = ((0, 0), (0, 1), (1, 1), (1, 0))
    return np.stack([(row + j) % down * across + (column + i) % across for j, i in corners], axis=1)


def split_quads(quads: Indices, other_diagonal: Indices | np.ndarray[tuple[int], np.dtype[np.bool_]]) -> Indices:
    """Split each quad (n, 4) along corners 0-2, or 1-3 where `other_diagonal` (n,) is true, into (2 n, 3)."""
    turned = np.where(np.asarray(other_diagonal, bool)[:, None], np.roll(quads, -1, axis=1), quads)
    return turned[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)


def grid_faces(
    columns: int,
    rows: int,
    *,
    triangulation: Triangulation = "alternating",
    periodic: tuple[bool, bool] = (False, False),
) -> Indices:
    """Return the triangles of a grid, (2 * columns * rows, 3).

    "alternating" alternates the diagonals like the colours of a chessboard, so that no direction is preferred.
    "uniform" makes all diagonals parallel, so that every inner vertex has six neighbours.
    """
    row, column = (index.ravel() for index in np.indices((rows, columns)))
    turned = (row + column) % 2 == 1 if triangulation == "alternating" else np.zeros(rows * columns, bool)
    return split_quads(grid_quads(columns, rows, periodic=periodic), turned)
