"""Writing triangles as a glb file: one mesh in one node, in single precision."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from unbend.arrays import Floats, Ints

_POINTS, _CORNERS = 34962, 34963  # targets of buffer views
_COMPONENTS: Final = {"<f4": 5126, "<u4": 5125, "|u1": 5121}


def write(
    vertices: Floats,
    faces: Ints,
    colours: Floats | None,
    uv: Floats | None,
    *,
    extra: Mapping[str, Floats] | None = None,
    about: Mapping[str, Any] | None = None,
) -> bytes:
    """Return a glb file. If both `uv` and `colours` are given, the file contains only `uv`.

    `extra` are further attributes of the vertices, (n, 1) or (n, 3). glTF requires that their names begin with an
    underscore. `about` becomes the `extras` of the asset.
    """
    attributes: dict[str, Any] = {"POSITION": np.asarray(vertices, "<f4")}
    gltf: dict[str, Any] = {"asset": {"version": "2.0", "generator": "unbend"}, "scene": 0}
    primitive: dict[str, Any] = {"attributes": {}, "indices": 0, "mode": 4}
    if uv is not None:
        # glTF measures v from the top, and a texture needs a material.
        attributes["TEXCOORD_0"] = np.stack([uv[:, 0], 1 - uv[:, 1]], axis=1).astype("<f4")
        gltf["materials"], primitive["material"] = [{"doubleSided": True}], 0
    elif colours is not None:
        opaque = np.full((len(colours), 1), 255)
        attributes["COLOR_0"] = np.hstack([np.rint(255 * colours), opaque]).astype("|u1")
    for name, values in (extra or {}).items():
        attributes[name] = np.asarray(values, "<f4")
    if about:
        gltf["asset"] = gltf["asset"] | {"extras": dict(about)}
    primitive["attributes"] = {name: number for number, name in enumerate(attributes, start=1)}
    arrays = [("SCALAR", np.asarray(faces, "<u4").ravel()), *((_kind(array), array) for array in attributes.values())]
    gltf |= {"scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}], "meshes": [{"primitives": [primitive]}]}
    gltf |= {
        "accessors": [_accessor(number, kind, array) for number, (kind, array) in enumerate(arrays)],
        "bufferViews": _views([array for _, array in arrays]),
        "buffers": [{"byteLength": sum(array.nbytes for _, array in arrays)}],
    }
    return _file(gltf, b"".join(array.tobytes() for _, array in arrays))


def _kind(array: Any) -> str:
    return "SCALAR" if array.shape[1] == 1 else f"VEC{array.shape[1]}"


def _accessor(view: int, kind: str, array: Any) -> dict[str, Any]:
    component = _COMPONENTS[array.dtype.str]
    described = {"bufferView": view, "componentType": component, "count": len(array), "type": kind}
    if component == _COMPONENTS["|u1"]:
        described["normalized"] = True
    if kind == "VEC3" and len(array):  # glTF requires the bounds of positions
        described |= {"min": array.min(axis=0).tolist(), "max": array.max(axis=0).tolist()}
    return described


def _views(arrays: list[Any]) -> list[dict[str, int]]:
    ends = np.cumsum([array.nbytes for array in arrays]).tolist()
    return [
        {"buffer": 0, "byteOffset": end - array.nbytes, "byteLength": array.nbytes,
         "target": _POINTS if array.ndim == 2 else _CORNERS}
        for end, array in zip(ends, arrays, strict=True)
    ]  # fmt: skip


def _file(gltf: dict[str, Any], binary: bytes) -> bytes:
    """Return a file of two chunks. All elements have 4, 8 or 12 bytes, so `binary` needs no padding."""
    text = json.dumps(gltf).encode()
    text += b" " * (-len(text) % 4)
    chunks = ((b"JSON", text), (b"BIN\0", binary))
    body = b"".join(struct.pack("<I4s", len(chunk), kind) + chunk for kind, chunk in chunks)
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body
