"""Triangulated surfaces."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final

import numpy as np

from unbend.arrays import Floats, Indices, Ints, frozen
from unbend.brief import brief, counted, noted
from unbend.errors import MeshGeometryError
from unbend.mesh.areas import triangle_areas
from unbend.mesh.report import MeshReport
from unbend.mesh.topology import Edges, find_edges
from unbend.notebook.pictured import Pictured

LARGEST_EXTENT: Final = 1e140
"""Largest extent of a surface; the smallest is its inverse.

Squared lengths, areas of thin faces and sums of areas then stay within the range of double precision.
"""


@dataclass(frozen=True, eq=False)
class Surface(Pictured):
    """A triangulated surface, not necessarily closed, connected, oriented or manifold.

    Parameters
    ----------
    vertices : (n, 3) float64
        Coordinates, in any unit. Distances to vertices without a face are infinite.
    faces : (m, 3) int32
        Indices of each triangle's corners.
    report : MeshReport
        Findings and repairs of reading; empty for a surface made in memory.
    vertex_map : (k,) int64, optional
        The surface's vertex for each of the k vertices of the file, -1 for none. None if the vertices are those of the
        file, because no seam was joined and the mesh was not simplified.

    Raises
    ------
    MeshGeometryError
        If the shapes are wrong, an index is out of range, a used coordinate is not finite, squared lengths would
        leave the range of double precision, or there is no face.
    """

    vertices: Floats
    faces: Ints
    report: MeshReport = field(default_factory=MeshReport)
    vertex_map: Indices | None = None

    def __post_init__(self) -> None:
        vertices = frozen(self.vertices, np.float64)
        check_mesh(vertices, np.asarray(self.faces))
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", frozen(self.faces, np.int32))
        if self.vertex_map is not None:
            object.__setattr__(self, "vertex_map", frozen(self.vertex_map, np.int64))
        self._check_coordinates()

    def __repr__(self) -> str:
        return brief(
            self, counted(len(self.vertices), "vertex", "vertices"), counted(len(self.faces), "face"),
            noted(len(self.report.warnings), "warning"),
        )  # fmt: skip

    @cached_property
    def edges(self) -> Edges:
        """The edges and the half-edges of each."""
        return find_edges(self.faces, len(self.vertices))

    @cached_property
    def extent(self) -> float:
        """Longest side of the bounding box of all faces, in units of the vertices."""
        every = len(self.used_vertices) == len(self.vertices)
        corners = self.vertices if every else self.vertices[self.used_vertices]
        with np.errstate(over="ignore"):
            return max(float(along.max() - along.min()) for along in corners.T)

    @property
    def scale(self) -> float:
        """Power of two above `extent`, 1 for an extent of 0. Division by it keeps squares in range without rounding."""
        return float(np.ldexp(1.0, np.frexp(self.extent)[1]))

    @cached_property
    def face_areas(self) -> Floats:
        """Area of each triangle, (m,)."""
        return frozen(triangle_areas(self.vertices, self.faces, self.scale), np.float64)

    @cached_property
    def used_vertices(self) -> Indices:
        """Vertices that faces use, in ascending order."""
        used = np.zeros(len(self.vertices), bool)
        used[self.faces] = True
        return frozen(np.flatnonzero(used), np.int64)

    @property
    def area(self) -> float:
        """Total area, in squared units of the vertices."""
        return float(self.face_areas.sum())

    @cached_property
    def vertex_areas(self) -> Floats:
        """A third of the area of the triangles around each vertex, (n,); they sum to `area`."""
        thirds = self.face_areas / 3
        return frozen(
            sum(np.bincount(self.faces[:, corner], thirds, minlength=len(self.vertices)) for corner in range(3)),
            np.float64,
        )

    def with_report(self, report: MeshReport) -> Surface:
        """Return the same surface with another report; arrays and computed values are shared."""
        other = copy(self)
        object.__setattr__(other, "report", report)
        return other

    def _check_coordinates(self) -> None:
        if not np.isfinite(self.vertices).all():
            bad = ~np.isfinite(self.vertices[self.used_vertices]).all(axis=1)
            if bad.any():
                row = int(self.used_vertices[bad][0])
                values = self.vertices[row].tolist()
                raise MeshGeometryError(f"vertex {row} has coordinates {values}, which are not finite")
        if self.extent > 0 and not 1 / LARGEST_EXTENT < self.extent < LARGEST_EXTENT:
            raise MeshGeometryError(
                f"the surface is {self.extent:.3g} units large, and squared lengths leave the range of double "
                "precision: scale its coordinates"
            )


def check_mesh(vertices: Floats, faces: Ints) -> None:
    """Raise MeshGeometryError if the shapes are wrong, there is no face, or an index is out of range."""
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise MeshGeometryError(f"vertices must be (n, 3), not {vertices.shape}")
    if faces.ndim != 2 or faces.shape[1] != 3:
        raise MeshGeometryError(f"faces must be (m, 3), not {faces.shape}")
    if len(faces) == 0:
        raise MeshGeometryError("the mesh has no faces")
    if faces.dtype.kind not in "iu" and not (faces.dtype.kind == "f" and (np.floor(faces) == faces).all()):
        raise MeshGeometryError("faces must be indices of vertices, which are whole numbers")
    if faces.min() < 0 or faces.max() >= len(vertices):
        row = int(np.flatnonzero((faces < 0).any(1) | (faces >= len(vertices)).any(1))[0])
        raise MeshGeometryError(
            f"face {row} uses vertices {faces[row].tolist()}, but the mesh has {len(vertices)} (numbered from 0)"
        )
