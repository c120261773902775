"""Meshes of a glTF file, each made of its primitives of triangles."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from unbend.arrays import Floats, Indices
from unbend.errors import MeshReadError
from unbend.mesh.formats.gltf_data import Data, item_of
from unbend.mesh.formats.strips import strip_faces

_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_MODES: Final = range(7)


def joined(parts: list[tuple[Floats, Indices]]) -> tuple[Floats, Indices]:
    """Return several meshes as one mesh, with the vertices of each after those of the previous one."""
    if len(parts) == 1:
        return parts[0]
    firsts = np.cumsum([0, *(len(vertices) for vertices, _ in parts[:-1])])
    faces = [faces + first for (_, faces), first in zip(parts, firsts, strict=True)]
    return np.concatenate([vertices for vertices, _ in parts]), np.concatenate(faces)


def _mode(primitive: dict[str, Any]) -> int:
    mode = primitive.get("mode", _TRIANGLES)
    if mode not in _MODES:
        raise MeshReadError(f"a primitive of the glb file has the unknown mode {repr(mode)[:40]}")
    return int(mode)


class Meshes:
    """The meshes of a glTF file by index. Sizes and meshes are cached.

    Primitives of one mesh that use the same accessor of positions share vertices. So a surface with several materials
    is not cut at their borders.
    """

    def __init__(self, gltf: dict[str, Any], data: Data) -> None:
        self._gltf = gltf
        self._data = data
        self._sizes: dict[int, tuple[int, int]] = {}
        self._meshes: dict[int, tuple[Floats, Indices]] = {}
        self.skipped = 0
        """Number of primitives of points or lines."""
        self.morphs = False
        """Whether a mesh has morph targets."""

    def size(self, mesh: int) -> tuple[int, int]:
        """Return the numbers of vertices and triangles that a mesh announces."""
        if mesh not in self._sizes:
            self._note(mesh)
            groups = self._groups(mesh)
            triangles = sum(self._triangles(primitive) for group in groups.values() for primitive in group)
            self._sizes[mesh] = sum(map(self._data.count, groups)), triangles
        return self._sizes[mesh]

    def mesh(self, mesh: int) -> tuple[Floats, Indices]:
        """Return the vertices and faces of a mesh in its own coordinates."""
        if mesh not in self._meshes:
            parts = []
            for positions, primitives in self._groups(mesh).items():
                vertices = self._data.values(positions, "VEC3").astype(np.float64)
                faces = np.concatenate([self._faces(primitive, len(vertices)) for primitive in primitives])
                parts.append((vertices, faces))
            self._meshes[mesh] = joined(parts)
        return self._meshes[mesh]

    def _primitives(self, mesh: int) -> list[dict[str, Any]]:
        found: list[dict[str, Any]] = item_of(self._gltf["meshes"], mesh)["primitives"]
        return found

    def _note(self, mesh: int) -> None:
        for primitive in self._primitives(mesh):
            self.skipped += _mode(primitive) < _TRIANGLES
            self.morphs |= bool(primitive.get("targets"))

    def _groups(self, mesh: int) -> dict[int, list[dict[str, Any]]]:
        """Return the primitives of a mesh that have triangles, grouped by the accessor of their positions."""
        groups: dict[int, list[dict[str, Any]]] = {}
        for primitive in self._primitives(mesh):
            if _mode(primitive) >= _TRIANGLES and "POSITION" in primitive["attributes"] and self._triangles(primitive):
                groups.setdefault(primitive["attributes"]["POSITION"], []).append(primitive)
        return groups

    def _triangles(self, primitive: dict[str, Any]) -> int:
        corners = self._data.count(primitive.get("indices", primitive["attributes"]["POSITION"]))
        return corners // 3 if _mode(primitive) == _TRIANGLES else max(0, corners - 2)

    def _faces(self, primitive: dict[str, Any], vertices: int) -> Indices:
        mode = _mode(primitive)
        restarts = np.zeros(vertices, bool)
        if "indices" not in primitive:
            corners = np.arange(vertices)
        else:
            found = self._data.values(primitive["indices"], "SCALAR")[:, 0]
            corners = found.astype(np.int64)
            # glTF forbids the largest number of the type as an index. Graphics hardware restarts a strip there.
            restarts = (corners == np.iinfo(found.dtype).max) & (corners >= vertices) & (mode == _STRIP)
        if ((corners < 0) | (corners >= vertices))[~restarts].any():
            raise MeshReadError(f"a triangle of the glb file uses a vertex beyond the {vertices} of its mesh")
        if mode == _STRIP:
            return strip_faces(corners, restarts)
        if mode == _TRIANGLES:
            if len(corners) % 3:
                raise MeshReadError(f"a primitive of the glb file has {len(corners)} corners, not a multiple of three")
            return corners.reshape(-1, 3)
        first = np.full(max(0, len(corners) - 2), corners[:1])
        return np.stack([first, corners[1:-1], corners[2:]], axis=1)
