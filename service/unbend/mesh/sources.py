"""Meshes as callers have them: files, surfaces, arrays, and the mesh objects of other libraries."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, BinaryIO, Final, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from unbend.brief import brief, counted
from unbend.errors import MeshFileError, MeshMissingError, ParameterError
from unbend.mesh.formats.ply import write_exactly
from unbend.mesh.formats.polygons import triangulated
from unbend.mesh.limits import UNLIMITED
from unbend.mesh.surface import check_mesh


class HasFaces(Protocol):
    """A mesh such as a `Surface` or a `trimesh.Trimesh`."""

    @property
    def vertices(self) -> Any:
        """Coordinates, (n, 3)."""

    @property
    def faces(self) -> Any:
        """Vertices of the triangles, (m, 3)."""


class HasTriangles(Protocol):
    """A mesh such as an `open3d.geometry.TriangleMesh`."""

    @property
    def vertices(self) -> Any:
        """Coordinates, (n, 3)."""

    @property
    def triangles(self) -> Any:
        """Vertices of the triangles, (m, 3)."""


class HasCells(Protocol):
    """A mesh such as a `meshio.Mesh`."""

    @property
    def points(self) -> Any:
        """Coordinates, (n, 3)."""

    @property
    def cells_dict(self) -> Any:
        """Vertices of the cells of each type, such as "triangle": (m, 3)."""


MeshSource = bytes | str | PathLike[str] | BinaryIO | tuple[ArrayLike, ArrayLike] | HasFaces | HasTriangles | HasCells
"""A mesh: bytes, a path, a binary file, vertices (n, 3) and faces (m, 3), a `Surface`, or a mesh object."""

_CELLS: Final = {"triangle": 3, "quad": 4}
"""Number of corners of each type of cells that make a surface. Other cells, such as lines, are left out."""


@dataclass(frozen=True, eq=False)
class MeshArrays:
    """Vertices (n, 3) and faces (m, 3) as a caller gave them, with valid indices."""

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]


@dataclass(frozen=True)
class MeshBytes:
    """The bytes of a mesh file."""

    data: bytes
    name: str = ""
    """Name of the file; empty if it has none."""

    def __repr__(self) -> str:
        return brief(self, self.name, counted(len(self.data), "byte"))

    @property
    def file_type(self) -> str:
        """The extension of the name, which counts if the content does not determine the format."""
        return Path(self.name).suffix.lower().lstrip(".")


def arrays_of(source: MeshSource) -> MeshArrays | None:
    """Return the arrays of a mesh in memory; None if `source` is a file.

    Raises
    ------
    MeshGeometryError
        If the arrays have wrong shapes, or an index is out of range.
    ParameterError
        If `source` is no mesh.
    """
    found = _arrays_of(source)
    if found is None:
        return None
    try:
        vertices, faces = np.asarray(found[0], np.float64), np.asarray(found[1])
    except (TypeError, ValueError) as error:
        raise ParameterError(f"the vertices or faces of a mesh are no arrays of numbers: {error}") from None
    check_mesh(vertices, faces)
    return MeshArrays(vertices, faces.astype(np.int64))


def bytes_of(source: MeshSource) -> MeshBytes:
    """Return a mesh as the bytes of a file: a file as it is, and a mesh in memory as ply of double precision.

    Raises
    ------
    MeshGeometryError
        If arrays have wrong shapes, or an index is out of range.
    ParameterError
        If `source` is no mesh.
    MeshFileError
        If a file cannot be opened; MeshMissingError if there is none.
    """
    if isinstance(source, bytes | bytearray | memoryview):
        return MeshBytes(bytes(source))
    if isinstance(source, str | PathLike):
        path = Path(source)
        with opened(path) as file:
            return MeshBytes(file.read(), path.name)
    mesh = arrays_of(source)
    return MeshBytes(write_exactly(mesh.vertices, mesh.faces)) if mesh else _read(source)


def opened(path: Path) -> BinaryIO:
    """Open the file of a mesh; MeshFileError if it cannot be opened, MeshMissingError if there is none."""
    try:
        return path.open("rb")
    except OSError as error:
        kind = MeshMissingError if isinstance(error, FileNotFoundError) else MeshFileError
        raise kind(error.errno, error.strerror, str(path)) from None


def _read(file: Any) -> MeshBytes:
    data = file.read()
    if not isinstance(data, bytes):
        raise ParameterError("a mesh file must be open for reading bytes: use mode 'rb'")
    name = getattr(file, "name", "")
    return MeshBytes(data, Path(name).name if isinstance(name, str) else "")


def _arrays_of(source: Any) -> tuple[Any, Any] | None:
    if isinstance(source, bytes | bytearray | memoryview | str | PathLike):
        return None
    if isinstance(source, tuple | list) and len(source) == 2:
        return source[0], source[1]
    for triangles in ("faces", "triangles"):
        if hasattr(source, "vertices") and hasattr(source, triangles):
            return source.vertices, getattr(source, triangles)
    if hasattr(source, "points") and hasattr(source, "cells_dict"):
        return source.points, _triangles(np.asarray(source.points, np.float64), source.cells_dict)
    if hasattr(source, "read"):
        return None
    raise ParameterError(
        f"{type(source).__name__} is no mesh: give a path, bytes, a binary file, vertices and faces as a pair of "
        "arrays, a Surface, or a mesh of trimesh, Open3D or meshio"
    )


def _triangles(points: NDArray[np.float64], cells: Any) -> NDArray[np.int64]:
    """Return the triangles of blocks of cells, quads cut in two."""
    blocks = [
        np.asarray(cells[kind], np.int64).reshape(-1, corners) for kind, corners in _CELLS.items() if kind in cells
    ]
    if not blocks:
        return np.zeros((0, 3), np.int64)
    counts = np.concatenate([np.full(len(block), block.shape[1]) for block in blocks])
    corners = np.concatenate([block.ravel() for block in blocks])
    return triangulated(points, corners, counts, UNLIMITED)[0]
