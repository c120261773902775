"""A flat circular sector, rolled isometrically into a right circular cone."""

from __future__ import annotations

import math

import numpy as np

from unbend.arrays import Floats, Indices
from unbend.mesh.shapes.checks import at_least, between
from unbend.mesh.shapes.grids import grid_faces, grid_parameters
from unbend.mesh.surface import Surface

FULL_TURN = 0.98 * 2 * math.pi
"""Angle of the fully rolled sector around the axis, at which its two straight edges almost meet."""


def cone(
    sector: float = 1.2 * math.pi,
    roll: float = 0.5,
    *,
    inner: float = 0.2,
    rings: int = 20,
    segments: int = 48,
) -> Surface:
    """Return a sector of the unit disc, rolled into a cone with its apex at the origin and its axis along z.

    A point at polar coordinates (r, phi) of the flat sector moves to the distance r from the apex and the angle
    phi * turn / sector around the axis, with turn = (1 - roll) * sector + roll * 0.98 * 2 pi. Arcs keep their length,
    so the half angle alpha of the cone satisfies sin(alpha) = sector / turn. The surfaces for all values of `roll` are
    isometric, with the area sector * (1 - inner^2) / 2.

    Parameters
    ----------
    sector : float, default 1.2 pi
        Angle of the flat sector, radians, from 0.1 to 0.98 * 2 pi.
    roll : float, default 0.5
        At 0 the sector is flat. At 1 its straight edges almost meet.
    inner : float, default 0.2
        Radius of the disc that is cut away around the apex, from 0 (keep the apex) to 0.95.
    rings, segments : int, default 20 and 48
        Cells along the radius and around the axis.

    Returns
    -------
    Surface
        With (rings + 1) * (segments + 1) vertices and the same faces for every `roll`. If inner = 0, the innermost ring
        is a single vertex.

    Raises
    ------
    ParameterError
        If an argument is out of its range.
    """
    between("sector", sector, 0.1, FULL_TURN)
    between("roll", roll, 0.0, 1.0)
    between("inner", inner, 0.0, 0.95)
    rings, segments = at_least("rings", rings, 1), at_least("segments", segments, 1)
    turn = (1 - roll) * sector + roll * FULL_TURN
    around, outward = grid_parameters(segments, rings)
    theta, r, sine = turn * around, inner + (1 - inner) * outward, min(sector / turn, 1.0)
    cosine = math.sqrt(1 - sine * sine)
    vertices = np.stack([r * sine * np.cos(theta), r * sine * np.sin(theta), -r * cosine], axis=1)
    # The grid runs around, then outward. That is clockwise seen from +z, which is the outside of the cone.
    faces = grid_faces(segments, rings)[:, ::-1]
    return Surface(*(_with_apex(vertices, faces, segments) if inner == 0 else (vertices, faces)))


def _with_apex(vertices: Floats, faces: Indices, segments: int) -> tuple[Floats, Indices]:
    """Merge the innermost ring, whose vertices coincide, and drop the triangles that vanish with it."""
    merged = np.maximum(faces - segments, 0)
    a, b, c = merged.T
    return vertices[segments:], merged[(a != b) & (b != c) & (c != a)]
