"""glb files: their triangles, placed by the nodes of their scene.

No decoder is run, and no other file is opened. Sizes are checked before anything is allocated.
glTF 2.0: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from typing import Any, Final

from unbend.errors import MeshFormatError, MeshReadError
from unbend.mesh.formats.gltf_data import Data
from unbend.mesh.formats.gltf_meshes import Meshes, joined
from unbend.mesh.formats.gltf_scene import Place, placed, places
from unbend.mesh.formats.gltf_writing import write
from unbend.mesh.formats.parsed import MeshFormat, ParsedMesh, left_over
from unbend.mesh.formats.text import shown
from unbend.mesh.limits import MeshLimits
from unbend.mesh.report import counted_noun

_JSON, _BINARY = b"JSON", b"BIN\0"
_HARMLESS: Final = (
    "KHR_materials_", "KHR_texture_", "EXT_texture_", "MSFT_texture_", "KHR_lights_", "EXT_lights_",
    "KHR_mesh_quantization", "KHR_animation_pointer", "KHR_xmp", "KHR_techniques_webgl", "KHR_audio",
    "EXT_structural_metadata", "EXT_feature_metadata", "EXT_mesh_features",
)  # fmt: skip
"""Prefixes of extensions that a file may require: they do not change its triangles."""


def recognises(data: bytes) -> bool:
    """Say whether a file begins with the word glTF."""
    return data.startswith(b"glTF")


def announced(_data: bytes) -> tuple[int, int]:
    """Return nothing: `read` counts before it decodes."""
    return 0, 0


def read(data: bytes, limits: MeshLimits) -> ParsedMesh:
    """Return all triangles of the file's scene, placed by its nodes.

    A damaged layout raises whatever its use raises: KeyError, TypeError and so on.
    """
    layout, binary, notes = _chunks(data)
    for name in layout.get("extensionsRequired", ()):
        if not str(name).startswith(_HARMLESS):
            raise MeshFormatError(f"the glb file needs {shown(str(name))}, which is not read: export it without")
    meshes = Meshes(layout, Data(layout, binary))
    vertices = triangles = 0
    for place in places(layout):
        size = meshes.size(place.mesh)
        vertices, triangles = vertices + size[0], triangles + size[1]
        limits.check(vertices, triangles)
    standing = [place for place in places(layout) if meshes.size(place.mesh)[1]]
    if not standing:
        raise MeshReadError("the glb file holds no triangles")
    parts = [placed(*meshes.mesh(place.mesh), place.matrix) for place in standing]
    return ParsedMesh(*joined(parts), (*notes, *_told(layout, meshes, standing)))


def _chunks(data: bytes) -> tuple[dict[str, Any], bytes, tuple[str, ...]]:
    """Return the layout, the binary chunk (empty where there is none), and a note on bytes behind them."""
    if len(data) < 12:
        raise MeshReadError(f"the glb file ends early: it has {len(data)} bytes")
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
        padded = position + -position % 4
        if data[padded + 4 : padded + 8] in (_JSON, _BINARY):
            position = padded  # some writers do not count the padding in the size
    if _JSON not in found:
        raise MeshReadError("the glb file has no layout: no chunk of it is JSON")
    try:
        layout = json.loads(found[_JSON].rstrip(b"\0 \t\r\n"))
    except (ValueError, RecursionError) as error:
        raise MeshReadError("the layout of the glb file is not JSON") from error
    if not isinstance(layout, dict):
        raise MeshReadError("the layout of the glb file is not an object")
    return layout, found.get(_BINARY, b""), left_over(len(data[length:].strip(b"\0")), "byte")


def _told(layout: dict[str, Any], meshes: Meshes, standing: list[Place]) -> Iterator[str]:
    """Yield a note on meshes put together, and on each part of the scene that the triangles do not show."""
    if len(standing) > 1:
        number = len({place.mesh for place in standing})
        yield f"{counted_noun(number, 'mesh', 'meshes')} in {len(standing):,} places of the glb file put together"
    if number := sum(place.skinned for place in standing):
        yield f"{counted_noun(number, 'mesh', 'meshes')} with a skin: taken in the pose it was bound in"
    if number := meshes.skipped:
        yield f"{counted_noun(number, 'part', 'parts')} of points or lines skipped"
    if meshes.morphs:
        yield "morph targets are not applied"
    if layout.get("animations"):
        yield "animations are not applied"
    if any("EXT_mesh_gpu_instancing" in place.extensions for place in standing):
        yield "copies made by EXT_mesh_gpu_instancing are not read: each mesh is there once"


GLB: Final = MeshFormat("glb", recognises, announced, read, write)
