"""Accessors of a glTF file: arrays of numbers in the file itself. Every position is checked before it is read."""

from __future__ import annotations

import base64
from typing import Any, Final

import numpy as np

from unbend.errors import MeshFormatError, MeshReadError
from unbend.mesh.formats.text import shown

_TYPES: Final = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_COLUMNS: Final = {"SCALAR": 1, "VEC3": 3}
_COMPRESSED: Final = ("KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression")


def item_of(items: Any, index: Any) -> Any:
    """Return the item at `index` of a list in the JSON; raise MeshReadError if there is none."""
    if not isinstance(items, list) or type(index) is not int or not 0 <= index < len(items):
        raise MeshReadError(f"the glb file refers to item {repr(index)[:40]}, which does not exist")
    return items[index]


class Data:
    """The accessors of a glTF file, and the buffers that contain their elements."""

    def __init__(self, gltf: dict[str, Any], binary: bytes) -> None:
        self._gltf = gltf
        self._binary = binary
        self._buffers: dict[int, bytes] = {}

    def count(self, accessor: int) -> int:
        """Return the number of elements that an accessor announces."""
        count = item_of(self._gltf["accessors"], accessor)["count"]
        if type(count) is not int or count < 0:
            raise MeshReadError(f"accessor {accessor} of the glb file has no valid count")
        return count

    def values(self, accessor: int, kind: str) -> Any:
        """Return an accessor's elements, (count, columns), in their own type, or from -1 to 1 if normalized."""
        described = item_of(self._gltf["accessors"], accessor)
        if described["type"] != kind:
            raise MeshReadError(f"accessor {accessor} of the glb file is {shown(str(described['type']))}, not {kind}")
        count, component, sparse = self.count(accessor), described["componentType"], described.get("sparse")
        columns = _COLUMNS[kind]
        if sparse:  # read first: this decodes the buffers whose size limits the count in `_zeros`
            rows = self._elements(sparse["indices"], sparse["count"], sparse["indices"]["componentType"], 1)[:, 0]
            changes = self._elements(sparse["values"], sparse["count"], component, columns)
        if "bufferView" in described:
            values = self._elements(described, count, component, columns)
        elif sparse:
            values = self._zeros(count, component, columns)
        else:
            raise MeshFormatError(
                f"accessor {accessor} of the glb file has no buffer view, which suggests compression: export the file "
                "uncompressed"
            )
        if sparse:
            values = values.copy()
            values[rows] = changes
        if described.get("normalized") and values.dtype.kind != "f":
            return np.maximum(values / np.iinfo(values.dtype).max, -1.0)
        return values

    def _zeros(self, count: int, component: int, columns: int) -> Any:
        """Return zeros, (count, columns), as the base of a sparse accessor without a buffer view."""
        size = len(self._binary) + sum(len(buffer) for buffer in self._buffers.values())
        if count > size:
            raise MeshReadError(f"the glb file announces {count:,} elements, but its data has {size:,} bytes")
        return np.zeros((count, columns), _TYPES[component])

    def _elements(self, where: dict[str, Any], count: int, component: int, columns: int) -> Any:
        view = item_of(self._gltf["bufferViews"], where["bufferView"])
        for name in _COMPRESSED:
            if name in view.get("extensions", ()):
                raise MeshFormatError(
                    f"the glb file is compressed ({name}), which is not supported: export it uncompressed"
                )
        begin, length = view.get("byteOffset", 0), view["byteLength"]
        buffer = self._buffer(view["buffer"])
        if min(begin, length) < 0 or begin + length > len(buffer):
            raise MeshReadError("a buffer view of the glb file extends beyond its buffer")
        kind = np.dtype(_TYPES[component])
        stride = view.get("byteStride", columns * kind.itemsize)
        if stride < columns * kind.itemsize:
            raise MeshReadError("a buffer view of the glb file has a stride shorter than its elements")
        within = memoryview(buffer)[begin : begin + length]
        # NumPy raises ValueError if the elements do not fit into the buffer.
        return np.ndarray((count, columns), kind, within, where.get("byteOffset", 0), (stride, kind.itemsize))

    def _buffer(self, index: int) -> bytes:
        uri = item_of(self._gltf["buffers"], index).get("uri")
        if uri is None:
            return self._binary if index == 0 else b""
        if index not in self._buffers:
            head, encoded, text = str(uri).partition(";base64,")
            if not (encoded and head.startswith("data:")):
                raise MeshFormatError("the glb file refers to data in another file, but only single files are read")
            self._buffers[index] = base64.b64decode(text)
        return self._buffers[index]
