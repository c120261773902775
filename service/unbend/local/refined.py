"""Finer triangulations of coarse surfaces."""

from __future__ import annotations

from typing import Final

import numpy as np

from unbend.mesh.surface import Surface

ENOUGH: Final = 3500
"""Vertices from which distances within small circles are accurate enough. A mesh of 252 vertices is divided twice."""


def refined(surface: Surface) -> Surface:
    """Divide all triangles into four until there are `ENOUGH` vertices; the surface stays the same set of points.

    Vertices keep their numbers; those without a face do not count.
    """
    while len(surface.used_vertices) < ENOUGH:
        surface = _divided(surface)
    return surface


def _divided(surface: Surface) -> Surface:
    faces, count = surface.faces, len(surface.vertices)
    sides = np.sort(np.stack([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]], axis=1), axis=2)
    edges, numbers = np.unique(sides.reshape(-1, 2), axis=0, return_inverse=True)
    ab, bc, ca = numbers.reshape(-1, 3).T + count
    a, b, c = faces.T
    quarters = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    middles = surface.vertices[edges].mean(axis=1)
    return Surface(
        np.concatenate([surface.vertices, middles]),
        np.concatenate([np.stack(corners, axis=1) for corners in quarters]).astype(np.int32),
    )
