"""The direction in which a distance grows at each vertex, as a complex number in its tangent plane."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from unbend.arrays import Floats
from unbend.mesh.surface import Surface

Directions = NDArray[np.complex64]


def directions_of(surface: Surface, sign: float, rows: NDArray[Any]) -> Directions:
    """Return the direction in which each of k rows of distances grows at each of n vertices, (n, k).

    Bending keeps the angles between shortest paths at a point. So bending turns all directions at a point by the same
    angle, which is arbitrary: each vertex has axes of its own. A reflection reverses the angles.

    Parameters
    ----------
    surface : Surface
    sign : float
        -1 if the corners of faces are counted clockwise as seen from outside, otherwise 1.
    rows : (k, n) array
    """
    found = (_gradient(surface, sign) @ np.asarray(rows, np.float32).T).astype(np.complex64)
    found /= np.maximum(np.abs(found), np.finfo(np.float32).tiny)
    return found


def vertex_normals(surface: Surface, sign: float) -> Floats:
    """Return the normal at each vertex, of length 1, (n, 3)."""
    planes = sign * _planes(surface)
    sums = [np.bincount(surface.faces.ravel(), np.repeat(each, 3), len(surface.vertices)) for each in planes.T]
    return _of_length_1(np.stack(sums, axis=1))


def _gradient(surface: Surface, sign: float) -> csr_array:
    """Return the matrix that maps values at the vertices to the area-weighted gradient around each, (n, n)."""
    faces, count = surface.faces, len(surface.vertices)
    vertices = (surface.vertices - surface.vertices[0]) / np.sqrt(surface.area)
    planes = _of_length_1(_planes(surface))
    normals = vertex_normals(surface, sign)
    along = _of_length_1(np.cross(np.eye(3)[np.abs(normals).argmin(axis=1)], normals))
    across = np.cross(normals, along)
    rows, columns, values = [], [], []
    for corner in range(3):
        slope = np.cross(planes, vertices[faces[:, (corner + 2) % 3]] - vertices[faces[:, (corner + 1) % 3]])
        for at in range(3):
            here = faces[:, at]
            rows.append(here)
            columns.append(faces[:, corner])
            values.append((slope * along[here]).sum(axis=1) + 1j * (slope * across[here]).sum(axis=1))
    entries = np.concatenate(values).astype(np.complex64)
    return csr_array((entries, (np.concatenate(rows), np.concatenate(columns))), shape=(count, count))


def _planes(surface: Surface) -> Floats:
    a, b, c = (surface.vertices[surface.faces[:, corner]] for corner in range(3))
    return np.asarray(np.cross(b - a, c - a))


def _of_length_1(vectors: Floats) -> Floats:
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors / np.maximum(lengths, np.finfo(np.float64).tiny))
