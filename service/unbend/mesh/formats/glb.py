"""glb files: triangles and where they stand, from the file itself and nothing else.

Read here and not by trimesh, which takes positions that are compressed or sparse for zeros, allocates whatever an
accessor announces, and runs a decoder if one is installed. Buffers in other files are refused: nothing is opened.
glTF 2.0: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html
"""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from unbend.arrays import Floats, Indices
from unbend.errors import MeshFormatError, MeshReadError
from unbend.mesh.formats.placement import node_matrix, placed
from unbend.mesh.limits import MeshLimits

_JSON, _BINARY = b"JSON", b"BIN\0"
_TYPES: Final = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_COLUMNS: Final = {"SCALAR": 1, "VEC3": 3}
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_COMPRESSED: Final = ("KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression")
_HARMLESS: Final = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_", "KHR_mesh_quantization")
"""Extensions a file may require without its triangles being other ones: what they begin with."""


def read_glb(data: bytes, limits: MeshLimits) -> tuple[Floats, Indices]:
    """Return vertices (n, 3) and faces (m, 3) of all triangles of the file's scene, placed by its nodes.

    Primitives of one mesh that share their positions share vertices, so that materials do not tear a surface.

    Raises
    ------
    MeshTooLargeError
        If there are more than `limits` allow, before any of them is decoded.
    MeshFormatError
        If they are compressed, or in another file.
    MeshReadError
        If the file is damaged. A layout that is none raises what its use raises: KeyError, TypeError, and so on.
    """
    glb = _Glb(*_chunks(data))
    glb.check_extensions()
    vertices = triangles = 0
    for mesh, _ in glb.instances():
        size = glb.size(mesh)
        vertices, triangles = vertices + size[0], triangles + size[1]
        limits.check(vertices, triangles)
    parts = [placed(*glb.mesh(mesh), matrix) for mesh, matrix in glb.instances() if glb.size(mesh)[1]]
    if not parts:
        raise MeshReadError("the glb file holds no triangles")
    return _joined(parts)


def _joined(parts: list[tuple[Floats, Indices]]) -> tuple[Floats, Indices]:
    if len(parts) == 1:
        return parts[0]
    firsts = np.cumsum([0, *(len(vertices) for vertices, _ in parts[:-1])])
    faces = [faces + first for (_, faces), first in zip(parts, firsts, strict=True)]
    return np.concatenate([vertices for vertices, _ in parts]), np.concatenate(faces)


def _chunks(data: bytes) -> tuple[dict[str, Any], bytes]:
    """Return the layout and the binary chunk, empty where there is none."""
    _, version, length = struct.unpack_from("<4sII", data)
    if version != 2:
        raise MeshFormatError(f"the file is glTF {version}, and only glTF 2 is read")
    if length > len(data):
        raise MeshReadError(f"the glb file ends early: {length} bytes announced, {len(data)} found")
    found: dict[bytes, bytes] = {}
    position = 12
    while position + 8 <= length:
        size, kind = struct.unpack_from("<I4s", data, position)
        if position + 8 + size > len(data):
            raise MeshReadError("a chunk of the glb file is longer than the file")
        found.setdefault(kind, data[position + 8 : position + 8 + size])
        position += 8 + size
    layout = json.loads(found[_JSON])
    if not isinstance(layout, dict):
        raise MeshReadError("the layout of the glb file is not an object")
    return layout, found.get(_BINARY, b"")


class _Glb:
    """A layout and the bytes it speaks of. Meshes are known by their index; what is found of one is kept."""

    def __init__(self, layout: dict[str, Any], binary: bytes) -> None:
        self.layout = layout
        self._binary = binary
        self._buffers: dict[int, bytes] = {}
        self._sizes: dict[int, tuple[int, int]] = {}
        self._meshes: dict[int, tuple[Floats, Indices]] = {}

    def check_extensions(self) -> None:
        for name in self.layout.get("extensionsRequired", ()):
            if not str(name).startswith(_HARMLESS):
                raise MeshFormatError(f"the glb file needs {_shown(name)}, which is not read: export it without")

    def size(self, mesh: int) -> tuple[int, int]:
        """Return how many vertices and triangles a mesh announces."""
        if mesh not in self._sizes:
            groups = self._groups(mesh)
            triangles = sum(self._triangles(primitive) for group in groups.values() for primitive in group)
            self._sizes[mesh] = sum(map(self._count, groups)), triangles
        return self._sizes[mesh]

    def mesh(self, mesh: int) -> tuple[Floats, Indices]:
        """Return vertices and faces of a mesh, where no node has moved it yet."""
        if mesh not in self._meshes:
            parts = []
            for positions, primitives in self._groups(mesh).items():
                vertices = self._values(positions, "VEC3").astype(np.float64)
                faces = np.concatenate([self._faces(primitive, len(vertices)) for primitive in primitives])
                parts.append((vertices, faces))
            self._meshes[mesh] = _joined(parts)
        return self._meshes[mesh]

    def _groups(self, mesh: int) -> dict[int, list[dict[str, Any]]]:
        """Return a mesh's primitives that have triangles, by the accessor of their positions."""
        groups: dict[int, list[dict[str, Any]]] = {}
        for primitive in _item(self.layout["meshes"], mesh)["primitives"]:
            mode = primitive.get("mode", _TRIANGLES)
            if mode in (_TRIANGLES, _STRIP, _FAN) and self._triangles(primitive):
                groups.setdefault(primitive["attributes"]["POSITION"], []).append(primitive)
        return groups

    def _count(self, accessor: int) -> int:
        """Return how many elements an accessor announces."""
        count = _item(self.layout["accessors"], accessor)["count"]
        if type(count) is not int or count < 0:
            raise MeshReadError(f"accessor {accessor} of the glb file has no count")
        return count

    def _triangles(self, primitive: dict[str, Any]) -> int:
        corners = self._count(primitive.get("indices", primitive["attributes"]["POSITION"]))
        return corners // 3 if primitive.get("mode", _TRIANGLES) == _TRIANGLES else max(0, corners - 2)

    def instances(self) -> Iterator[tuple[int, Floats]]:
        """Yield each node's mesh and place, from the roots down; a node has one parent at most, so this ends."""
        nodes = self.layout.get("nodes", [])
        waiting = [(root, np.eye(4)) for root in reversed(self._roots)]
        seen = set()
        while waiting:
            index, above = waiting.pop()
            if index in seen:
                raise MeshReadError(f"node {index} of the glb file stands in two places")
            seen.add(index)
            node = _item(nodes, index)
            matrix = above @ node_matrix(node)
            waiting += [(child, matrix) for child in reversed(node.get("children", []))]
            if "mesh" in node:
                yield node["mesh"], matrix

    @property
    def _roots(self) -> list[int]:
        if "scenes" in self.layout:
            scene = _item(self.layout["scenes"], self.layout.get("scene", 0))
            return list(scene.get("nodes", []))
        nodes = self.layout.get("nodes", [])
        children = {child for node in nodes for child in node.get("children", [])}
        return [index for index in range(len(nodes)) if index not in children]

    def _faces(self, primitive: dict[str, Any], vertices: int) -> Indices:
        mode = primitive.get("mode", _TRIANGLES)
        if "indices" not in primitive:
            corners = np.arange(vertices)
        else:
            corners = self._values(primitive["indices"], "SCALAR")[:, 0].astype(np.int64)
        if len(corners) and not 0 <= corners.min() <= corners.max() < vertices:
            raise MeshReadError(f"a triangle of the glb file is outside its {vertices} vertices")
        if mode == _TRIANGLES:
            if len(corners) % 3:
                raise MeshReadError(f"{len(corners)} corners in the glb file are no triangles")
            return corners.reshape(-1, 3)
        first = corners[:-2] if mode == _STRIP else np.full(max(0, len(corners) - 2), corners[:1])
        faces = np.stack([first, corners[1:-1], corners[2:]], axis=1)
        if mode == _STRIP:
            faces[1::2] = faces[1::2, ::-1]  # each second triangle of a strip runs around the other way
        return faces

    def _values(self, accessor: int, kind: str) -> Any:
        """Return an accessor's elements, (count, columns)."""
        described = _item(self.layout["accessors"], accessor)
        if described["type"] != kind:
            raise MeshReadError(f"accessor {accessor} of the glb file is {_shown(described['type'])}, not {kind}")
        count, component = self._count(accessor), described["componentType"]
        if "bufferView" not in described:
            raise MeshFormatError(
                f"accessor {accessor} of the glb file has no data of its own, as if it were compressed: export it "
                "uncompressed"
            )
        values = self._elements(described, count, component, _COLUMNS[kind])
        if sparse := described.get("sparse"):
            values, changed = values.copy(), sparse["count"]
            rows = self._elements(sparse["indices"], changed, sparse["indices"]["componentType"], 1)[:, 0]
            values[rows] = self._elements(sparse["values"], changed, component, _COLUMNS[kind])
        if described.get("normalized") and values.dtype.kind != "f":
            return np.maximum(values / np.iinfo(values.dtype).max, -1.0)
        return values

    def _elements(self, where: dict[str, Any], count: int, component: int, columns: int) -> Any:
        view = _item(self.layout["bufferViews"], where["bufferView"])
        for name in _COMPRESSED:
            if name in view.get("extensions", ()):
                raise MeshFormatError(f"the glb file is compressed ({name}), which is not read: export it uncompressed")
        begin, length = view.get("byteOffset", 0), view["byteLength"]
        buffer = self._buffer(view["buffer"])
        if min(begin, length) < 0 or begin + length > len(buffer):
            raise MeshReadError("a part of the glb file's data is outside it")
        kind = np.dtype(_TYPES[component])
        stride = view.get("byteStride", columns * kind.itemsize)
        if stride < columns * kind.itemsize:
            raise MeshReadError("elements of the glb file's data overlap")
        within = memoryview(buffer)[begin : begin + length]
        # NumPy refuses what does not lie within the buffer
        return np.ndarray((count, columns), kind, within, where.get("byteOffset", 0), (stride, kind.itemsize))

    def _buffer(self, index: int) -> bytes:
        uri = _item(self.layout["buffers"], index).get("uri")
        if uri is None:
            return self._binary if index == 0 else b""
        if index not in self._buffers:
            head, encoded, text = str(uri).partition(";base64,")
            if not (encoded and head.startswith("data:")):
                raise MeshFormatError("data of the glb file is in another one: only single files are read")
            self._buffers[index] = base64.b64decode(text)
        return self._buffers[index]


def _item(items: Any, index: Any) -> Any:
    if not isinstance(items, list) or type(index) is not int or not 0 <= index < len(items):
        raise MeshReadError(f"the glb file has no item {_shown(index)} where it says so")
    return items[index]


def _shown(value: Any) -> str:
    return repr(value)[:40]
