"""glb files: their triangles, placed by the nodes of the scene.

The reader decompresses nothing and opens no other file. It checks sizes before it allocates memory. In the modules for
glTF, `gltf` is the parsed JSON of the file.
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
from unbend.mesh.formats.gltf_scene import Instance, instances, transformed
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
"""Prefixes of the extensions that a file may require, because they do not change its triangles."""


def recognises(data: bytes) -> bool:
    """Return whether a file begins with the word glTF."""
    return data[:4] == b"glTF"


def announced(_data: bytes) -> tuple[int, int]:
    """Return 0 for unknown: `read` counts before it decodes."""
    return 0, 0


def read(data: bytes, limits: MeshLimits) -> ParsedMesh:
    """Return all triangles of the file's scene, placed by its nodes.

    Damaged JSON raises exceptions of any type, such as KeyError or TypeError.
    """
    gltf, binary, notes = _chunks(data)
    for name in gltf.get("extensionsRequired", ()):
        if not str(name).startswith(_HARMLESS):
            raise MeshFormatError(
                f"the glb file requires {shown(str(name))}, which is not supported: export the file without it"
            )
    meshes = Meshes(gltf, Data(gltf, binary))
    vertices = triangles = 0
    for instance in instances(gltf):
        size = meshes.size(instance.mesh)
        vertices, triangles = vertices + size[0], triangles + size[1]
        limits.check(vertices, triangles)
    found = [instance for instance in instances(gltf) if meshes.size(instance.mesh)[1]]
    if not found:
        raise MeshReadError("the glb file contains no triangles")
    parts = [transformed(*meshes.mesh(instance.mesh), instance.matrix) for instance in found]
    return ParsedMesh(*joined(parts), (*notes, *_notes(gltf, meshes, found)))


def _chunks(data: bytes) -> tuple[dict[str, Any], bytes, tuple[str, ...]]:
    """Return the parsed JSON chunk, the binary chunk (empty if there is none), and a note on bytes after the chunks."""
    if len(data) < 12:
        raise MeshReadError(f"the glb file ends early: it has {len(data)} bytes")
    _, version, length = struct.unpack_from("<4sII", data)
    if version != 2:
        raise MeshFormatError(f"the file is glTF {version}, but only glTF 2 is supported")
    if length > len(data):
        raise MeshReadError(f"the glb file ends early: its header announces {length} bytes, but it has {len(data)}")
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
            position = padded  # some writers leave the padding out of the size
    if _JSON not in found:
        raise MeshReadError("the glb file has no JSON chunk")
    try:
        gltf = json.loads(found[_JSON].rstrip(b"\0 \t\r\n"))
    except (ValueError, RecursionError) as error:
        raise MeshReadError("the JSON chunk of the glb file is not valid JSON") from error
    if not isinstance(gltf, dict):
        raise MeshReadError("the JSON chunk of the glb file is not an object")
    return gltf, found.get(_BINARY, b""), left_over(len(data[length:].strip(b"\0")), "byte")


def _notes(gltf: dict[str, Any], meshes: Meshes, found: list[Instance]) -> Iterator[str]:
    """Yield a note on merged meshes, and on each part of the scene that the triangles do not represent."""
    if len(found) > 1:
        number = len({instance.mesh for instance in found})
        yield f"{len(found):,} instances of {counted_noun(number, 'mesh', 'meshes')} of the glb file merged"
    if number := sum(instance.skinned for instance in found):
        yield f"{counted_noun(number, 'mesh', 'meshes')} with a skin: read in the bind pose"
    if number := meshes.skipped:
        yield f"{counted_noun(number, 'primitive', 'primitives')} of points or lines skipped"
    if meshes.morphs:
        yield "morph targets are not applied"
    if gltf.get("animations"):
        yield "animations are not applied"
    if any("EXT_mesh_gpu_instancing" in instance.extensions for instance in found):
        yield "copies made by EXT_mesh_gpu_instancing are not read: each mesh is read once"


GLB: Final = MeshFormat("glb", recognises, announced, read, write)
