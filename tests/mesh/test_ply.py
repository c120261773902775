"""ply files of other programs: byte orders, further properties, polygons; and damaged files."""

from __future__ import annotations

import re
import struct
import time

import numpy as np
import pytest

from unbend import read_mesh
from unbend.errors import MeshReadError
from unbend.mesh.shapes import torus

POINTS = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1.5))
TYPES = ("char", "uchar", "short", "ushort", "int", "uint", "int64", "uint64", "float", "double")
LETTERS = dict(zip(TYPES, "bBhHiIqQfd", strict=True))
POLYGONS = ((0, 1, 2), (0, 2, 3, 4), (0, 1, 4))
FACES = [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 1, 4]]
TEXT = (
    "ply\nformat ascii 1.0\nobj_info x\nelement vertex 5\nproperty float x\nproperty float y\nproperty float z\n"
    "element face 3\nproperty list uchar int vertex_indices\nend_header\n"
    "0 0 0\n1 0 0\n1 1 0\n0 1 0\n0 0 1.5\n3 0 1 2\n4 0 2 3 4\n3 0 1 4\n"
)


def binary(order: str, polygons: tuple[tuple[int, ...], ...] = POLYGONS, texture: int = 2) -> bytes:
    """Return a file with properties before, between and after the ones that are read, and edges at its end."""
    name = {"<": "little", ">": "big"}[order]
    head = (
        f"ply\r\nformat binary_{name}_endian 1.0\r\ncomment by hand\r\nelement vertex {len(POINTS)}\r\n"
        "property uchar red\r\nproperty double z\r\nproperty double x\r\nproperty short a\r\nproperty float y\r\n"
        f"element face {len(polygons)}\r\nproperty float quality\r\nproperty list ushort float texcoord\r\n"
        "property list uchar uint vertex_index\r\nelement edge 1\r\nproperty int vertex1\r\nend_header\r\n"
    )
    body = b"".join(struct.pack(f"{order}Bddhf", 9, z, x, -1, y) for x, y, z in POINTS)
    for corners in polygons:
        body += struct.pack(f"{order}fH{texture}f", 0.5, texture, *(0.5,) * texture)
        body += struct.pack(f"{order}B{len(corners)}I", len(corners), *corners)
    return head.encode() + body + struct.pack(f"{order}i", 1)


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("texture", [0, 2])
@pytest.mark.parametrize("polygons", [POLYGONS, POLYGONS[::-1], POLYGONS[:1] + POLYGONS[2:]])
def test_binary_ply_files_are_read_in_both_byte_orders(order, polygons, texture):
    surface = read_mesh(binary(order, polygons, texture))
    np.testing.assert_array_equal(surface.vertices, POINTS)
    expected = [[face[0], *face[i : i + 2]] for face in polygons for i in range(1, len(face) - 1)]
    np.testing.assert_array_equal(surface.faces, expected)


@pytest.mark.parametrize("text", [TEXT, TEXT.replace("\n", "\r\n"), TEXT.replace("vertex_indices", "corners")])
def test_text_ply_files_are_read(text):
    surface = read_mesh(text.encode())
    np.testing.assert_array_equal(surface.vertices, POINTS)
    np.testing.assert_array_equal(surface.faces, FACES)


HEADER, ROWS = TEXT.split("end_header\n")


def beginning(order: str) -> tuple[str, bytes]:
    """Return the header of a binary file up to its faces, and its vertices as bytes."""
    whole = binary(order)
    rows = whole[whole.index(b"end_header\r\n") + 12 :]
    return whole.partition(b"element face")[0].decode(), rows[: 5 * struct.calcsize("<Bddhf")]


def strips(*chains: tuple[int, ...]) -> bytes:
    head, vertices = beginning("<")
    head += f"element tristrips {len(chains)}\r\nproperty list int int vertex_indices\r\nend_header\r\n"
    return head.encode() + vertices + b"".join(struct.pack(f"<{len(row) + 1}i", len(row), *row) for row in chains)


def test_strips_of_triangles_alternate_and_end_at_minus_one():
    surface = read_mesh(strips((0, 1, 3, 2, -1, 0, 1, 4), (-1, -1, 3, 0, -1, 3, 0, 4)))
    np.testing.assert_array_equal(surface.faces, [[0, 1, 3], [2, 3, 1], [0, 1, 4], [3, 0, 4]])
    with pytest.raises(MeshReadError, match=r"strip 1 .* vertex 5"):
        read_mesh(strips((0, 1, 3), (1, 2, 5)))


@pytest.mark.parametrize(
    ("data", "note"),
    [
        (TEXT.replace("face 3", "face 2").encode(), "1 line after the end skipped"),
        ((TEXT + "the end\n").encode(), "1 line after the end skipped"),
        (binary("<") + b"more", "4 bytes after the end skipped"),
        (TEXT.replace("obj_info x", "made by hand").encode(), "lines of the header skipped, the first 'made by hand'"),
        (TEXT.replace("4 0 2 3 4", "2 0 2").encode(), "1 face of fewer than three corners skipped"),
        (binary(">", (*POLYGONS, ())), "1 face of fewer than three corners skipped"),
    ],
)
def test_skipped_parts_of_a_ply_file_are_noted(data, note):
    report = read_mesh(data).report
    assert note in report.notes


WITH_QUALITY = re.sub("^(. . [.0-9]+)$", r"\1 -1.#IND00", TEXT, flags=re.MULTILINE).replace(
    "float z\n", "float z\nproperty float quality\n"
)


@pytest.mark.parametrize(
    "data",
    [
        TEXT.replace("\n", "\r").encode(),
        b"\xef\xbb\xbf" + TEXT.encode(),
        HEADER.upper().encode() + b"END_HEADER\n" + ROWS.encode(),
        HEADER.encode() + b"end_header \n" + ROWS.replace("\n", " \n\n").encode(),
        HEADER.encode() + b"end_header\n" + ROWS.replace("\n", " ").encode(),
        HEADER.encode() + b"end_header\ncomment here\n" + ROWS.encode() + b"\0\0\n",
        HEADER.replace("uchar int", "float double").encode() + b"end_header\n" + ROWS.encode(),
        WITH_QUALITY.encode(),
    ],
)
def test_variants_of_a_text_ply_file_give_the_same_mesh(data):
    surface = read_mesh(data)
    np.testing.assert_array_equal(surface.vertices, POINTS)
    np.testing.assert_array_equal(surface.faces, FACES)
    assert surface.report.notes == read_mesh(TEXT.encode()).report.notes


@pytest.mark.parametrize("counter", LETTERS)
@pytest.mark.parametrize("order", "<>")
def test_the_length_of_a_list_may_have_any_type(counter, order):
    head, body = beginning(order)
    head += f"element face 3\r\nproperty list {counter} uchar vertex_index\r\nend_header\r\n"
    body += b"".join(struct.pack(f"{order}{LETTERS[counter]}{len(face)}B", len(face), *face) for face in POLYGONS)
    np.testing.assert_array_equal(read_mesh(head.encode() + body).faces, FACES)
    with pytest.raises(MeshReadError, match="ends early"):
        read_mesh(head.encode() + body[:-1])


def test_many_faces_of_mixed_sizes_are_read_in_seconds():
    number = 300_000
    polygons = np.tile([3, 0, 1, 2, 4, 0, 2, 3, 4], number).astype("<u1").tobytes()
    head = HEADER.replace("ascii", "binary_little_endian").replace("uchar int", "uchar uchar")
    head = head.replace("face 3", f"face {2 * number}") + "end_header\n"
    data = head.encode() + np.array(POINTS, "<f4").tobytes() + polygons
    read_mesh(binary("<"))  # compiles the kernels
    begun = time.process_time()
    assert read_mesh(data).report.faces == 3 * number
    assert time.process_time() - begun < 10


def test_mixed_polygons_with_the_size_of_quads_are_not_read_as_quads():
    surface = read_mesh(binary("<", ((0, 1, 2, 3), (0, 1, 4), (0, 1, 2, 3, 4))))
    np.testing.assert_array_equal(surface.faces[:4], [[0, 1, 2], [0, 2, 3], [0, 1, 4], [0, 3, 4]])


def test_ply_files_of_trimesh_are_read():
    import trimesh

    shape = torus(columns=12, rows=9)
    for encoding in ("ascii", "binary"):
        data = trimesh.Trimesh(shape.vertices, shape.faces, process=False).export(file_type="ply", encoding=encoding)
        surface = read_mesh(data)
        np.testing.assert_allclose(surface.vertices, shape.vertices, atol=1e-6)
        np.testing.assert_array_equal(surface.faces, shape.faces)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (TEXT[: TEXT.index("3 0 1 4")].encode(), "ends early"),
        (TEXT.replace("format ascii 1.0\n", "").encode(), "line 4: .* names no format"),
        (TEXT.replace("4 0 2", "4000000000 0 2").encode(), "4000000000"),
        (TEXT.replace("4 0 2", "-4 0 2").encode(), "-4"),
        (TEXT.replace("4 0 2", "nan 0 2").encode(), "nan"),
        (TEXT.replace("0 0 0\n", "0 0 0 255 0 0\n").encode(), "line 11: 6 numbers"),
        (TEXT.replace("1 1 0", "1 1").encode(), "line 13: 2 numbers, not as many as the header says"),
        (TEXT.replace("1 1 0\n0 1 0", "1 1\n0 0 1 0").encode(), "line 13: 2 numbers"),
        (TEXT.replace("3 0 1 4", "3 0 1 4.5").encode(), "face 2 .*: 4.5 is not the index of a vertex"),
        (TEXT.replace("3 0 1 4", "3 0 1 1e300").encode(), r"1e\+300 is not the index of a vertex"),
        (TEXT.replace("3 0 1 4", "3 0 1 nan").encode(), "nan is not the index of a vertex"),
        (TEXT.replace("3 0 1 4", "3 0 1 5").encode(), "face 2 .*: a face uses vertex 5, but the vertices are 0 to 4"),
        (TEXT.replace("1 1 0", "1 x 0").encode(), "line 13: numbers expected, found '1 x 0'"),
        (TEXT.replace("property float z\n", "").encode(), "no z"),
        (TEXT.replace("element face 3", "element edge 3").encode(), "neither faces nor strips"),
        (TEXT.replace("property float y", "property colour y").encode(), "line 6"),
        (TEXT.replace("property float y", "property y").encode(), "line 6"),
        (TEXT.replace("vertex 5", "vertex five").encode(), "line 4"),
        (TEXT.replace("vertex 5", "vertex " + "5" * 5000).encode(), "line 4"),
        (TEXT.replace("format ascii", "format text").encode(), "line 2"),
        (TEXT.replace("format ascii 1.0\n", "").encode(), "line 4"),
        (TEXT.replace("element face 3", "element vertex 3").encode(), "line 8"),
        (TEXT.replace("list uchar int vertex_indices", "int a\nproperty int b").encode(), "no vertex_indices"),
        (b"ply\nformat ascii 1.0\n", "header"),
        (binary("<")[:-5], "ends early"),
    ],
)
def test_errors_in_a_ply_file_are_reported(data, message):
    with pytest.raises(MeshReadError, match=message) as raised:
        read_mesh(data)
    assert len(str(raised.value)) < 200
