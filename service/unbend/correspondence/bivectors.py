"""Orientation: which side of a surface is out, and the oriented tangent planes of functions on it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from unbend.arrays import Floats
from unbend.mesh.surface import Surface

R = TypeVar("R", bound=np.floating[Any])

BIVECTOR_FUNCTIONS: Final = slice(1, 9)
"""The functions of the basis whose tangent planes are compared: smooth ones, without the constant."""


@dataclass(frozen=True)
class Orientation:
    """Whether the faces of a surface agree on a side, and which sign makes it the outer one."""

    known: bool
    """Whether each pair of neighbouring faces agrees. Otherwise the surface has no known side."""
    closed: bool
    """Whether there is no boundary, so that the outer side follows from the volume. On an open surface, the side is
    the one from which the corners of the file's faces are counted anticlockwise."""
    sign: float
    """-1 if the faces show inwards, otherwise 1."""


def orientation_of(surface: Surface) -> Orientation:
    """Find the orientation of a surface, from its faces alone."""
    faces, count = surface.faces.astype(np.int64), len(surface.vertices)
    directed = np.concatenate([faces[:, i] * count + faces[:, (i + 1) % 3] for i in range(3)])
    known = len(np.unique(directed)) == len(directed)
    closed = surface.edges.boundary == 0
    corners = (surface.vertices - surface.vertices[surface.faces[0, 0]])[surface.faces] / surface.scale
    volume = np.einsum("fi,fi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
    return Orientation(known, closed, -1.0 if known and closed and volume < 0 else 1.0)


def vertex_bivectors(surface: Surface, functions: Floats, sign: float) -> Floats:
    """Return the mean bivector around each vertex of the surface embedded by `functions` (n, k), (n, k (k - 1) / 2).

    A triangle with the edges u and v in k dimensions has the bivector u ^ v: its oriented plane, times twice its area.
    Its components are the Jacobian determinants of pairs of functions, so they change sign with the orientation
    (compare Ren et al. 2018, "Continuous and orientation-preserving correspondences via functional maps").
    """
    faces = surface.faces
    u, v = functions[faces[:, 1]] - functions[faces[:, 0]], functions[faces[:, 2]] - functions[faces[:, 0]]
    first, second = np.triu_indices(functions.shape[1], 1)
    planes = sign * (u[:, first] * v[:, second] - u[:, second] * v[:, first])
    around = np.empty((len(functions), planes.shape[1]))
    for component in range(planes.shape[1]):
        around[:, component] = np.bincount(faces.ravel(), np.repeat(planes[:, component], 3), minlength=len(functions))
    return around


def compound(matrix: NDArray[R]) -> NDArray[R]:
    """Return the second compound matrix: how bivectors change where a matrix multiplies vectors."""
    i, j = np.triu_indices(matrix.shape[0], 1)
    k, m = np.triu_indices(matrix.shape[1], 1)
    return np.asarray(matrix[np.ix_(i, k)] * matrix[np.ix_(j, m)] - matrix[np.ix_(i, m)] * matrix[np.ix_(j, k)])


def directions(bivectors: NDArray[R]) -> NDArray[R]:
    """Return bivectors of length 1; zero stays zero."""
    lengths = np.linalg.norm(bivectors, axis=1, keepdims=True)
    return np.asarray(bivectors / np.maximum(lengths, np.finfo(np.float32).tiny))
