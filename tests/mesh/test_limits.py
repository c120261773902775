"""Limits on vertices and triangles apply before memory is allocated, also if a header lies."""

from __future__ import annotations

import struct
import time
import tracemalloc

import numpy as np
import pytest

from tests.support.fuzzing import glb, triangle_layout
from unbend import MeshPolicy, read_mesh
from unbend.api import Settings
from unbend.errors import MeshError, MeshFormatError, MeshReadError, MeshTooLargeError
from unbend.mesh.limits import MeshLimits
from unbend.mesh.shapes import torus
from unbend.mesh.write import write_mesh

TORUS = torus(columns=12, rows=8)
FORMATS = ["off", "obj", "ply", "stl", "glb", "text stl", "indented obj", "commented off", "text ply"]


def file_of(kind: str) -> bytes:
    import trimesh

    if "stl" in kind:
        mesh = trimesh.Trimesh(TORUS.vertices, TORUS.faces, process=False)
        data = mesh.export(file_type="stl_ascii" if "text" in kind else "stl")
        return data.encode() if isinstance(data, str) else data
    if kind == "text ply":
        return trimesh.Trimesh(TORUS.vertices, TORUS.faces, process=False).export(file_type="ply", encoding="ascii")
    data = write_mesh(TORUS.vertices, TORUS.faces, kind.rpartition(" ")[2])
    if kind == "indented obj":
        return b"\t" + data.replace(b"\n", b"\n\t")
    return data.replace(b"OFF\n", b"OFF # torus\n\n#\n") if kind == "commented off" else data


@pytest.mark.parametrize("kind", FORMATS)
def test_a_file_may_have_exactly_as_many_vertices_and_faces_as_the_limits(kind):
    data, vertices, faces = file_of(kind), len(TORUS.vertices), len(TORUS.faces)
    assert len(read_mesh(data, limits=MeshLimits(vertices, faces)).faces) == faces
    for limits in (MeshLimits(vertices=vertices - 1), MeshLimits(faces=faces - 1)):
        with pytest.raises(MeshTooLargeError, match=r"more than [\d,]+ (vertices|triangles)"):
            read_mesh(data, limits=limits)


@pytest.mark.parametrize(
    "data", [b"OFF\n4 1 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n", b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n"]
)
def test_polygons_count_as_their_triangles(data):
    assert len(read_mesh(data, limits=MeshLimits(faces=2)).faces) == 2
    with pytest.raises(MeshTooLargeError):
        read_mesh(data, limits=MeshLimits(faces=1))


def test_limits_apply_to_the_file_before_simplification():
    with pytest.raises(MeshTooLargeError):
        read_mesh(file_of("ply"), policy=MeshPolicy(max_vertices=20), limits=MeshLimits(vertices=50))


def test_each_instance_of_a_mesh_counts():
    layout, data = triangle_layout(nodes=[{"mesh": 0}] * 3, scenes=[{"nodes": [0, 1, 2]}])
    assert len(read_mesh(glb(layout, data), policy=MeshPolicy("bridge"), limits=MeshLimits(12)).vertices) == 12
    with pytest.raises(MeshTooLargeError):
        read_mesh(glb(layout, data), limits=MeshLimits(vertices=11))


def test_the_settings_of_the_server_limit_meshes():
    assert Settings(max_vertices=7, max_faces=9).limits.mesh == MeshLimits(7, 9)


def accessor(**changes: object) -> bytes:
    layout, data = triangle_layout()
    layout["accessors"][0] |= changes
    return glb(layout, data)


def without_view() -> bytes:
    layout, data = triangle_layout()
    del layout["accessors"][0]["bufferView"]
    layout["accessors"][0]["count"] = 10**9
    return glb(layout, data)


def overlapping() -> bytes:
    layout, data = triangle_layout()
    layout["bufferViews"][0]["byteStride"] = 1
    return glb(layout, data)


def ply(order: str, vertices: int, faces: int, list_count: str, body: bytes) -> bytes:
    head = f"ply\nformat {order} 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\nproperty float z\n"
    return f"{head}element face {faces}\nproperty list {list_count} int vertex_indices\nend_header\n".encode() + body


LIES = {
    "off": b"OFF\n1000000000 1000000000 0\n0 0 0\n",
    "off, digits": b"OFF\n" + b"9" * 4000 + b" 1 0\n0 0 0\n",
    "off, more digits": b"OFF\n" + b"9" * 5000 + b" 1 0\n0 0 0\n",
    "off, binary": b"OFF BINARY\n" + struct.pack(">3i", 2**31 - 1, 2**31 - 1, 0) + bytes(60),
    "off, binary corners": b"OFF BINARY\n" + struct.pack(">3i9f2i", 3, 1, 0, *range(9), 2**31 - 1, 0) + bytes(60),
    "off, dimensions": b"nOFF\n1000000000\n3 1 0\n" + b"1 " * 99,
    "off, corners": b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n1000000000 0 1 2\n",
    "ply": ply("binary_little_endian", 10**9, 10**9, "uchar", bytes(60)),
    "ply, text": ply("ascii", 10**9, 10**9, "uchar", b"0 0 0\n"),
    "ply, digits": ply("ascii", 10**17, 1, "uchar", b"0 0 0\n"),
    "ply, list": ply("binary_little_endian", 3, 1, "uint", bytes(36) + b"\xff" * 16),
    "ply, strips": ply("binary_little_endian", 3, 1, "uint", bytes(36) + b"\xff" * 16).replace(b"face", b"tristrips"),
    "ply, double list": ply("binary_big_endian", 3, 1, "double", bytes(36) + struct.pack(">d", 1e300) + bytes(16)),
    "ply, no properties": b"ply\nformat binary_little_endian 1.0\nelement vertex 1000000000\nend_header\n" + bytes(60),
    "stl": bytes(80) + struct.pack("<I", 10**9) + bytes(50),
    "glb": accessor(count=10**9),
    "glb, digits": accessor(count=10**40),
    "glb, negative": accessor(count=-4),
    "glb, true": accessor(count=True),
    "glb, offset": accessor(byteOffset=10**12),
    "glb, negative offset": accessor(byteOffset=-4),
    "glb, no view": without_view(),
    "glb, overlapping": overlapping(),
    "glb, length": struct.pack("<4sIII", b"glTF", 2, 2**32 - 1, 2**32 - 1) + b"JSON{}",
}


@pytest.mark.parametrize("lie", LIES)
def test_a_lying_header_costs_little_memory_and_time(lie):
    with pytest.raises(MeshError):  # compiles kernels, so that the measurement does not include this
        read_mesh(LIES[lie], file_type=lie.split(",")[0])
    tracemalloc.start()
    begun = time.process_time()
    try:
        with pytest.raises(MeshError):
            read_mesh(LIES[lie], file_type=lie.split(",")[0])
        assert tracemalloc.get_traced_memory()[1] < 2**20
        assert time.process_time() - begun < 1
    finally:
        tracemalloc.stop()


def test_many_instances_are_counted_quickly():
    number = 20_000
    layout, data = triangle_layout(nodes=[{"mesh": 0}] * number, scenes=[{"nodes": list(range(number))}])
    layout["meshes"][0]["primitives"] *= 200
    begun = time.process_time()
    with pytest.raises(MeshTooLargeError):
        read_mesh(glb(layout, data), limits=MeshLimits(faces=4_000_000))
    assert time.process_time() - begun < 5


REPEATED = [
    b"\n",
    b" ",
    b"\r",
    b"v ",
    b"v\n",
    b"f 1/",
    b"#\n",
    b"\\\n",
    b"OFF ",
    b"solid\n",
    b"ply\n",
    b"facet ",
    b"end\t",
    b"endsolid ",
    b"1 ",
    b"1-1 ",
    b"3 0 1 2\n",
    b"/",
    b"\\ ",
    b"\xef\xbb\xbf",
    b"<!",
    b"property list uchar int a\n",
]
BEFORE = [b"x\n", b"v 0 0 0\nf 1 2 3 ", b"OFF\n", b"solid\nfacet\n", b"ply\nformat ascii 1.0\nelement vertex 3\n"]


@pytest.mark.parametrize("repeated", REPEATED)
@pytest.mark.parametrize("before", BEFORE)
def test_repetitive_text_is_read_in_linear_time(before, repeated):
    begun = time.process_time()
    with pytest.raises(MeshError):
        read_mesh(before + repeated * (100_000 // len(repeated)))
    assert time.process_time() - begun < 2  # in an earlier version, 20,000 blank lines took a minute


# Features of glb that are read, and features that are refused


def test_sparse_accessors_are_read():
    layout, data = triangle_layout()
    replaced = np.array([2, 2, 2], "<f4").tobytes()
    layout["bufferViews"] += [
        {"buffer": 0, "byteOffset": len(data), "byteLength": 4},
        {"buffer": 0, "byteOffset": len(data) + 4, "byteLength": 12},
    ]
    layout["accessors"][0]["sparse"] = {
        "count": 1, "indices": {"bufferView": 2, "componentType": 5125}, "values": {"bufferView": 3},
    }  # fmt: skip
    surface = read_mesh(glb(layout, data + struct.pack("<I", 3) + replaced))
    np.testing.assert_array_equal(surface.vertices, [[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 2, 2]])


def test_primitives_with_shared_positions_share_vertices():
    layout, data = triangle_layout()
    only = layout["meshes"][0]["primitives"][0]
    layout["accessors"] += [
        {"bufferView": 1, "componentType": 5123, "count": 3, "type": "SCALAR"},
        {"bufferView": 1, "componentType": 5123, "count": 3, "type": "SCALAR", "byteOffset": 6},
    ]
    layout["meshes"][0]["primitives"] = [only | {"indices": 2}, only | {"indices": 3}]
    surface = read_mesh(glb(layout, data))
    np.testing.assert_array_equal(surface.faces, [[0, 1, 2], [1, 3, 2]])
    assert (len(surface.vertices), surface.report.components) == (4, 1)


@pytest.mark.parametrize(("mode", "faces"), [(5, [[0, 1, 2], [3, 2, 1]]), (6, [[0, 1, 2], [0, 2, 3]])])
def test_strips_and_fans_become_triangles(mode, faces):
    layout, data = triangle_layout()
    layout["meshes"][0]["primitives"] = [{"attributes": {"POSITION": 0}, "mode": mode}]
    np.testing.assert_array_equal(read_mesh(glb(layout, data)).faces, faces)


def test_nodes_transform_their_meshes():
    half = 0.5**0.5
    nodes = [
        {"children": [1], "translation": [0, 0, 5]},
        {"mesh": 0, "rotation": [0, 0, half, half], "scale": [2, 1, 1]},
    ]
    layout, data = triangle_layout(nodes=nodes)
    expected = [[0, 0, 5], [0, 2, 5], [-1, 0, 5], [-1, 2, 5.5]]
    np.testing.assert_allclose(read_mesh(glb(layout, data)).vertices, expected, atol=1e-12)
    mirrored = read_mesh(
        glb(layout | {"nodes": [{"mesh": 0, "matrix": np.diag([-1, 1, 1, 1]).ravel().tolist()}]}, data)
    )
    np.testing.assert_array_equal(mirrored.vertices[1], [-1, 0, 0])
    np.testing.assert_array_equal(mirrored.faces[0], [2, 1, 0])


def test_normalised_integers_are_scaled_to_one():
    layout, _ = triangle_layout()
    layout["accessors"][0] |= {"componentType": 5121, "normalized": True}
    layout["bufferViews"] = [
        {"buffer": 0, "byteLength": 16, "byteStride": 4},
        {"buffer": 0, "byteOffset": 16, "byteLength": 12},
    ]
    points = bytes([0, 0, 0, 9, 255, 0, 0, 9, 0, 255, 0, 9, 51, 255, 0, 9])
    surface = read_mesh(glb(layout, points + np.array([0, 1, 2, 1, 3, 2], "<u2").tobytes()))
    np.testing.assert_allclose(surface.vertices, [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.2, 1, 0]])


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"extensionsRequired": ["KHR_draco_mesh_compression"]}, MeshFormatError, "KHR_draco"),
        ({"extensionsRequired": ["x" * 10**6]}, MeshFormatError, "requires"),
        ({"nodes": [{"mesh": 0, "children": [0]}]}, MeshReadError, "occurs twice"),
        ({"scenes": [{"nodes": [0, 0]}]}, MeshReadError, "occurs twice"),
        ({"scenes": [{"nodes": [-1]}]}, MeshReadError, "item -1, which does not exist"),
        ({"scenes": [{"nodes": []}]}, MeshReadError, "no triangles"),
        ({"nodes": [{"mesh": "x" * 10**6}]}, MeshReadError, "item .* which does not exist"),
        ({"meshes": []}, MeshReadError, "item 0, which does not exist"),
        ({"bufferViews": [{"buffer": 0, "byteLength": 99}] * 2}, MeshReadError, "beyond its buffer"),
        ({"accessors": 5}, MeshReadError, "damaged|does not exist"),
    ],
)
def test_an_invalid_glb_layout_is_refused(changes, error, message):
    layout, data = triangle_layout(**changes)
    with pytest.raises(error, match=message) as raised:
        read_mesh(glb(layout, data))
    assert len(str(raised.value)) < 200


def test_compressed_data_is_refused_without_running_a_decoder(tmp_path, monkeypatch):
    ran = tmp_path / "ran"
    (tmp_path / "DracoPy.py").write_text(f"open({str(ran)!r}, 'w').close()\n")
    monkeypatch.syspath_prepend(tmp_path)
    extension = {"KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {"POSITION": 0}}}
    layout, data = triangle_layout(extensionsUsed=list(extension))
    layout["meshes"][0]["primitives"][0]["extensions"] = extension
    assert len(read_mesh(glb(layout, data)).faces) == 2  # the file also has uncompressed data
    for item in layout["accessors"]:
        del item["bufferView"]
    with pytest.raises(MeshFormatError, match="uncompressed"):
        read_mesh(glb(layout, data))
    assert not ran.exists()
