"""Smoothing of a surface: Taubin's lambda-mu smoothing."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.sparse import csr_array, eye_array

from unbend.arrays import Floats, Ints, positions_of
from unbend.mesh.surface import Surface

SHRINK: Final = 0.5
SWELL: Final = -0.53
"""Lambda and mu (Taubin 1995): frequencies below 1 / lambda + 1 / mu, 0.11 of at most 2, are kept."""


def smoothed_vertices(surface: Surface, rounds: int) -> Floats:
    """Return the vertices of `surface` after rounds of smoothing, (n, 3), in units of the vertices.

    In each round every vertex first moves towards the mean of its neighbours, by half of the difference, and then away
    from their new mean, by 53 % of the difference. This removes noise and keeps the size, because features much larger
    than the triangles stay. Boundary vertices count only boundary vertices as neighbours, so that an outline is
    smoothed along itself. Vertices without a face do not move.

    G. Taubin, "A signal processing approach to fair surface design", SIGGRAPH 1995.
    """
    used = surface.used_vertices
    means = _neighbour_means(surface)
    identity = eye_array(len(used), format="csr")
    steps = [(1 - share) * identity + share * means for share in (SHRINK, SWELL)]
    vertices = surface.vertices.copy()
    middle = vertices[used[0]]  # moves the surface near the origin, so that rounding errors are smaller than the steps
    points = vertices[used] - middle
    for _ in range(rounds):
        for step in steps:
            points = step @ points
    vertices[used] = points + middle
    return vertices


def boundary_edges(surface: Surface) -> Ints:
    """Return the two vertices of each edge that has a single face, (b, 2)."""
    return _ends(surface, surface.edges.starts[surface.edges.counts == 1])


def relative_boundary(surface: Surface) -> float:
    """Return the length of the boundary over the square root of the area."""
    a, b = surface.vertices[boundary_edges(surface)].transpose(1, 0, 2)
    return float(np.linalg.norm(a - b, axis=1).sum() / np.sqrt(surface.area))


def _ends(surface: Surface, starts: Ints) -> Ints:
    face, corner = np.divmod(surface.edges.order[starts], 3)
    return np.stack([surface.faces[face, (corner + 1) % 3], surface.faces[face, (corner + 2) % 3]], axis=1)


def _neighbour_means(surface: Surface) -> csr_array:
    """Return the matrix that maps values at the k used vertices to the means over their neighbours, (k, k)."""
    used, rim = surface.used_vertices, boundary_edges(surface)
    place = positions_of(used, len(surface.vertices)).astype(np.int32)
    on_rim = np.zeros(len(used), bool)
    on_rim[place[rim]] = True
    every, along = (_both_ways(place[ends]) for ends in (_ends(surface, surface.edges.starts), rim))
    pairs = np.concatenate([every[~on_rim[every[:, 0]]], along])
    weights = 1 / np.bincount(pairs[:, 0])
    return csr_array((weights[pairs[:, 0]], tuple(pairs.T)), shape=(len(used), len(used)))


def _both_ways(pairs: Ints) -> Ints:
    return np.concatenate([pairs, pairs[:, ::-1]])
