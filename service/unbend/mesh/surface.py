"""The value that every later step starts from: a triangulated surface."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from unbend.arrays import Floats, Indices, Ints, frozen
from unbend.errors import MeshGeometryError
from unbend.mesh.report import MeshReport


@dataclass(frozen=True, eq=False)
class Surface:
    """A triangulated surface; it need not be closed, connected, oriented or manifold.

    Parameters
    ----------
    vertices : (n, 3) float64
        Coordinates, in any unit. Vertices that no face uses are allowed: distances to them are infinite.
    faces : (m, 3) int32
        Indices of each triangle's corners.
    report : MeshReport
        What reading found and repaired; empty for a surface made in memory.

    Raises
    ------
    MeshGeometryError
        If the shapes are wrong, a used coordinate is not finite, an index is out of range, or there is no face.
    """

    vertices: Floats
    faces: Ints
    report: MeshReport = field(default_factory=MeshReport)

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertices", frozen(self.vertices, np.float64))
        object.__setattr__(self, "faces", frozen(self.faces, np.int32))
        _check(self.vertices, self.faces)

    @cached_property
    def face_areas(self) -> Floats:
        """Area of each triangle, (m,)."""
        a, b, c = (self.vertices[self.faces[:, corner]] for corner in range(3))
        return frozen(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1), np.float64)

    @cached_property
    def used_vertices(self) -> Indices:
        """Vertices that faces use, in rising order."""
        return frozen(np.unique(self.faces), np.int64)

    @property
    def area(self) -> float:
        """Total area, in squared units of the vertices."""
        return float(self.face_areas.sum())

    @cached_property
    def vertex_areas(self) -> Floats:
        """A third of the area of the triangles around each vertex, (n,); they sum to `area`."""
        thirds = np.repeat(self.face_areas / 3, 3)
        return frozen(np.bincount(self.faces.ravel(), thirds, minlength=len(self.vertices)), np.float64)


def _check(vertices: Floats, faces: Ints) -> None:
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise MeshGeometryError(f"vertices must be (n, 3), not {vertices.shape}")
    if faces.ndim != 2 or faces.shape[1] != 3:
        raise MeshGeometryError(f"faces must be (m, 3), not {faces.shape}")
    if len(faces) == 0:
        raise MeshGeometryError("the mesh has no faces")
    if faces.min() < 0 or faces.max() >= len(vertices):
        row = int(np.flatnonzero((faces < 0).any(1) | (faces >= len(vertices)).any(1))[0])
        raise MeshGeometryError(
            f"face {row} uses vertices {faces[row].tolist()}, but the mesh has {len(vertices)} (numbered from 0)"
        )
    used = np.zeros(len(vertices), bool)
    used[faces] = True
    bad = used & ~np.isfinite(vertices).all(axis=1)
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        raise MeshGeometryError(f"vertex {row} has coordinates {vertices[row].tolist()}, which are not finite")
