"""Closed surfaces: sphere, ellipsoid, torus, tetrahedron; all with outward normals."""

from __future__ import annotations

import math

import numpy as np

from unbend.arrays import Floats, Indices
from unbend.errors import ParameterError
from unbend.mesh.shapes.checks import at_least, positive
from unbend.mesh.shapes.grids import grid_faces
from unbend.mesh.subdivide import subdivided
from unbend.mesh.surface import Surface


def sphere(subdivisions: int = 3, *, radius: float = 1.0) -> Surface:
    """Return an icosphere: an icosahedron whose triangles are repeatedly split in four.

    Parameters
    ----------
    subdivisions : int, default 3
        From 0 (the icosahedron) to 7. The sphere has 10 * 4^subdivisions + 2 vertices.
    radius : float, default 1.0
        Distance of every vertex from the origin.

    Raises
    ------
    ParameterError
        If an argument is out of its range.
    """
    vertices, faces = _icosahedron()
    for _ in range(at_least("subdivisions", subdivisions, 0, 7)):
        vertices, faces = subdivided(vertices, faces)
        vertices /= np.linalg.norm(vertices, axis=1, keepdims=True)
    return Surface(positive("radius", radius) * vertices, faces)


def ellipsoid(semi_axes: tuple[float, float, float] = (1.0, 0.75, 0.5), *, subdivisions: int = 3) -> Surface:
    """Return the icosphere stretched along x, y and z.

    Parameters
    ----------
    semi_axes : three floats, default (1.0, 0.75, 0.5)
        Half of the extent along each axis.
    subdivisions : int, default 3
        As in `sphere`.

    Raises
    ------
    ParameterError
        If an argument is out of its range.
    """
    if len(semi_axes) != 3:
        raise ParameterError(f"semi_axes must be three numbers, not {semi_axes!r}")
    ball = sphere(subdivisions)
    return Surface(ball.vertices * [positive("semi_axes", axis) for axis in semi_axes], ball.faces)


def torus(major: float = 1.0, minor: float = 0.4, *, columns: int = 60, rows: int = 24) -> Surface:
    """Return a torus around z, of area 4 pi^2 major * minor.

    Parameters
    ----------
    major, minor : float, default 1.0 and 0.4
        Radius of the circle in the middle of the tube, and radius of the tube; minor < major.
    columns, rows : int, default 60 and 24
        Cells around the axis and around the tube, at least 3 each.

    Raises
    ------
    ParameterError
        If an argument is out of its range.
    """
    if not positive("minor", minor) < positive("major", major):
        raise ParameterError(f"minor must be below major, not {minor!r} and {major!r}")
    columns, rows = at_least("columns", columns, 3), at_least("rows", rows, 3)
    row, column = (index.ravel() for index in np.indices((rows, columns)))
    u, v = 2 * math.pi * column / columns, 2 * math.pi * row / rows
    ring = major + minor * np.cos(v)
    vertices = np.stack([ring * np.cos(u), ring * np.sin(u), minor * np.sin(v)], axis=1)
    return Surface(vertices, grid_faces(columns, rows, periodic=(True, True)))


def tetrahedron(edge: float = 1.0) -> Surface:
    """Return a regular tetrahedron with edges of length `edge`, centred on the origin.

    Raises
    ------
    ParameterError
        If `edge` is not positive.
    """
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / math.sqrt(8)
    return Surface(positive("edge", edge) * corners, np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]]))


def _icosahedron() -> tuple[Floats, Indices]:
    """Return two poles and two staggered rings of five vertices, at the heights +-1 / sqrt(5) of the unit sphere."""
    turn = np.arange(5) * 2 * math.pi / 5
    height, ring = 1 / math.sqrt(5), 2 / math.sqrt(5)
    upper = np.stack([ring * np.cos(turn), ring * np.sin(turn), np.full(5, height)], axis=1)
    lower = np.stack([ring * np.cos(turn + math.pi / 5), ring * np.sin(turn + math.pi / 5), -upper[:, 2]], axis=1)
    vertices = np.vstack([[[0, 0, 1]], upper, lower, [[0, 0, -1]]])
    here, after = np.arange(5), (np.arange(5) + 1) % 5
    top = np.stack([np.zeros(5, int), 1 + here, 1 + after], axis=1)
    band = np.vstack(
        [
            np.stack([1 + here, 6 + here, 1 + after], axis=1),
            np.stack([1 + after, 6 + here, 6 + after], axis=1),
        ]
    )
    bottom = np.stack([np.full(5, 11), 6 + after, 6 + here], axis=1)
    return vertices, np.vstack([top, band, bottom])
