"""Finer triangles on the same surface."""

from __future__ import annotations

import numpy as np

from unbend.arrays import Floats, Indices, Ints


def subdivided(vertices: Floats, faces: Ints) -> tuple[Floats, Indices]:
    """Split every triangle in four at the middles of its edges; vertices keep their numbers."""
    edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    unique, inverse = np.unique(edges, axis=0, return_inverse=True)
    a, b, c = faces.T
    ab, bc, ca = (inverse.reshape(-1, 3) + len(vertices)).T
    children = [np.stack(corners, axis=1) for corners in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))]
    return np.vstack([vertices, vertices[unique].mean(axis=1)]), np.vstack(children)
