"""glb files by glTF 2.0: scenes and transforms, notes about skipped parts, and errors."""

from __future__ import annotations

import json
import struct

import numpy as np
import pytest

from tests.support.fuzzing import glb, triangle_layout
from unbend.errors import MeshError, MeshFormatError, MeshReadError
from unbend.mesh.formats.parsed import ParsedMesh
from unbend.mesh.formats.registry import REGISTRY
from unbend.mesh.limits import UNLIMITED

POINTS = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.5]]
FACES = [[0, 1, 2], [1, 3, 2]]


def parsed(data: bytes) -> ParsedMesh:
    return REGISTRY["glb"].read(data, UNLIMITED)


def check(data: bytes) -> tuple[str, ...]:
    mesh = parsed(data)
    np.testing.assert_array_equal(mesh.vertices, POINTS)
    np.testing.assert_array_equal(mesh.faces, FACES)
    return mesh.notes


def chunked(*chunks: tuple[bytes, bytes], version: int = 2, behind: bytes = b"") -> bytes:
    body = b"".join(struct.pack("<I4s", len(chunk), kind) + chunk for kind, chunk in chunks)
    return struct.pack("<4sII", b"glTF", version, 12 + len(body)) + body + behind


LAYOUT, DATA = triangle_layout()
TEXT = json.dumps(LAYOUT).encode()


@pytest.mark.parametrize(
    "data",
    [
        glb(LAYOUT, DATA),
        chunked((b"JSON", TEXT + bytes(5)), (b"BIN\0", DATA + bytes(3))),
        chunked((b"JSON", TEXT + b" \n\0"), (b"BIN\0", DATA), behind=bytes(8)),
        chunked((b"JSON", b"\xef\xbb\xbf" + TEXT), (b"BIN\0", DATA)),
        chunked((b"JSON", TEXT + b" " * (3 - len(TEXT) % 4)), (b"\0BIN\0"[1:], DATA)),
        chunked((b"JSON", TEXT + b" " * (-len(TEXT) % 4)), (b"MORE", b"abcd"), (b"BIN\0", DATA)),
        glb({key: value for key, value in LAYOUT.items() if key not in {"scene", "scenes", "nodes"}}, DATA),
        glb({key: value for key, value in LAYOUT.items() if key not in {"scene", "scenes"}}, DATA),
        glb(LAYOUT | {"extensionsRequired": ["KHR_materials_unlit", "KHR_mesh_quantization"]}, DATA),
        glb(LAYOUT | {"extensionsRequired": ["EXT_mesh_features", "KHR_techniques_webgl"]}, DATA),
    ],
)
def test_variants_of_a_glb_file_give_the_same_mesh(data):
    assert check(data) == ()


def test_a_chunk_size_without_the_padding_is_accepted():
    text = TEXT + b" " * (-len(TEXT) % 4 + 1)
    first = struct.pack("<I4s", len(text), b"JSON") + text + b"\0" * (-len(text) % 4)
    body = first + struct.pack("<I4s", len(DATA), b"BIN\0") + DATA
    assert check(struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body) == ()


def test_a_primitive_without_indices_uses_vertices_in_order():
    layout, _ = triangle_layout()
    del layout["meshes"][0]["primitives"][0]["indices"]
    layout["accessors"][0]["count"] = 6
    layout["bufferViews"][0]["byteLength"] = 72
    soup = np.array(POINTS, "<f4")[np.ravel(FACES)]
    layout["bufferViews"][1]["byteOffset"] = 0
    mesh = parsed(glb(layout, soup.tobytes()))
    np.testing.assert_array_equal(mesh.vertices, soup)
    np.testing.assert_array_equal(mesh.faces, [[0, 1, 2], [3, 4, 5]])


def sparse_only(count: int) -> bytes:
    layout, data = triangle_layout()
    accessor = layout["accessors"][0]
    del accessor["bufferView"]
    accessor["count"] = count
    layout["bufferViews"].append({"buffer": 0, "byteOffset": len(data), "byteLength": 3})
    layout["bufferViews"].append({"buffer": 0, "byteOffset": 12, "byteLength": 36})
    accessor["sparse"] = {
        "count": 3, "indices": {"bufferView": 2, "componentType": 5121}, "values": {"bufferView": 3},
    }  # fmt: skip
    return glb(layout, data + bytes([1, 2, 3]))


def test_sparse_positions_without_a_buffer_start_from_zeros():
    assert check(sparse_only(4)) == ()
    for count in (10**6, 10**9):
        with pytest.raises(MeshReadError, match=f"{count:,} elements, .* data has"):
            parsed(sparse_only(count))


def test_the_transform_of_a_skinned_node_is_ignored_with_a_note():
    nodes = [{"children": [1, 2], "scale": [2, 2, 2]}, {"mesh": 0, "skin": 0, "translation": [9, 9, 9]}, {"mesh": 0}]
    mesh = parsed(glb(LAYOUT | {"nodes": nodes, "skins": [{"joints": [0]}]}, DATA))
    np.testing.assert_array_equal(mesh.vertices, [*POINTS, *(2 * np.array(POINTS))])
    np.testing.assert_array_equal(mesh.faces, [*FACES, *(4 + np.array(FACES))])
    assert mesh.notes == (
        "2 instances of 1 mesh of the glb file merged",
        "1 mesh with a skin: read in the bind pose",
    )


def test_triangle_strips_may_restart():
    layout, _ = triangle_layout()
    layout["meshes"][0]["primitives"][0]["mode"] = 5
    layout["accessors"][1]["count"] = 8
    layout["bufferViews"][1]["byteLength"] = 16
    points, corners = np.array(POINTS, "<f4"), np.array([0, 1, 2, 3, 0xFFFF, 0, 1, 3], "<u2")
    mesh = parsed(glb(layout, points.tobytes() + corners.tobytes()))
    np.testing.assert_array_equal(mesh.faces, [[0, 1, 2], [3, 2, 1], [0, 1, 3]])
    layout["meshes"][0]["primitives"][0]["mode"] = 6
    with pytest.raises(MeshReadError, match="beyond the 4"):
        parsed(glb(layout, points.tobytes() + corners.tobytes()))


def primitives(*more: dict) -> bytes:
    layout, data = triangle_layout()
    layout["meshes"][0]["primitives"] += more
    return glb(layout, data)


INSTANCES = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": 0}}}


@pytest.mark.parametrize(
    ("data", "note"),
    [
        (primitives({"attributes": {"POSITION": 0}, "mode": 0}), "1 primitive of points or lines skipped"),
        (
            primitives({"attributes": {"POSITION": 0}, "mode": 3}, {"attributes": {}, "mode": 1}),
            "2 primitives of points",
        ),
        (primitives() + b"more", "4 bytes after the end skipped"),
        (glb(LAYOUT | {"animations": [{}]}, DATA), "animations are not applied"),
        (glb(LAYOUT | {"nodes": [{"mesh": 0, "extensions": INSTANCES}]}, DATA), "each mesh is read once"),
    ],
)
def test_skipped_parts_of_a_glb_file_are_noted(data, note):
    (reported,) = check(data)
    assert note in reported


def test_morph_targets_are_noted():
    layout, data = triangle_layout()
    layout["meshes"][0]["primitives"][0]["targets"] = [{"POSITION": 0}]
    assert check(glb(layout, data)) == ("morph targets are not applied",)


def test_a_primitive_without_positions_is_ignored():
    assert check(primitives({"attributes": {"NORMAL": 0}, "indices": 1})) == ()


@pytest.mark.parametrize(
    ("data", "error", "message"),
    [
        (b"glTF", MeshReadError, "it has 4 bytes"),
        (chunked((b"JSON", TEXT), version=1), MeshFormatError, "glTF 1, but only glTF 2"),
        (chunked((b"BIN\0", DATA)), MeshReadError, "no JSON chunk"),
        (chunked((b"JSON", TEXT[:-9])), MeshReadError, "not valid JSON"),
        (chunked((b"JSON", b"[]")), MeshReadError, "not an object"),
        (glb(LAYOUT, DATA)[:-1], MeshReadError, "ends early"),
        (primitives({"attributes": {"POSITION": 0}, "mode": 7}), MeshReadError, "mode 7"),
        (primitives({"attributes": {"POSITION": 0}, "mode": "x"}), MeshError, "mode 'x'"),
        (glb(LAYOUT | {"extensionsRequired": ["EXT_mesh_gpu_instancing"]}, DATA), MeshFormatError, "gpu_instancing"),
        (glb(LAYOUT | {"scenes": [{"nodes": []}]}, DATA), MeshReadError, "no triangles"),
    ],
)
def test_errors_in_a_glb_file_are_reported(data, error, message):
    with pytest.raises(error, match=message):
        parsed(data)
