"""stl files of other programs, binary and text, as the reader returns them before any repair."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from unbend import read_mesh
from unbend.errors import MeshFormatError, MeshReadError
from unbend.mesh.formats.detect import detect_format
from unbend.mesh.formats.parsed import ParsedMesh
from unbend.mesh.formats.registry import REGISTRY
from unbend.mesh.limits import UNLIMITED

CORNERS = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0.5], [0, 1, 0]]])


def binary(header: bytes = b"", count: int = 2, behind: bytes = b"", normals: float = 0) -> bytes:
    facets = b"".join(struct.pack("<12fH", *(normals,) * 3, *corners.ravel(), 0) for corners in CORNERS)
    return header.ljust(80, b" ") + struct.pack("<I", count) + facets + behind


def facet(corners: np.ndarray) -> str:
    rows = "".join(f"   vertex {x:e} {y:e} {z:e}\n" for x, y, z in corners)
    return f" facet normal 0 0 1\n  outer loop\n{rows}  endloop\n endfacet\n"


TEXT = f"solid part\n{facet(CORNERS[0])}{facet(CORNERS[1])}endsolid part\n"


def parsed(data: str | bytes, hint: str | None = None) -> ParsedMesh:
    data = data if isinstance(data, bytes) else data.encode()
    assert detect_format(data, hint) == "stl"
    return REGISTRY["stl"].read(data, UNLIMITED)


def check(data: str | bytes, hint: str | None = None) -> tuple[str, ...]:
    mesh = parsed(data, hint)
    np.testing.assert_array_equal(mesh.vertices, CORNERS.reshape(-1, 3))
    np.testing.assert_array_equal(mesh.faces, [[0, 1, 2], [3, 4, 5]])
    return mesh.notes


@pytest.mark.parametrize(
    "header",
    [b"", b"solid made by", b"solid facet normal", b"ply\n", b"OFF 2 3 4", b"v 1 2 3\nf 1", b"glTF\2\0\0\0", b"PK\3\4"],
)
@pytest.mark.parametrize(("behind", "notes"), [(b"", ()), (b"x", ("1 byte after the end skipped",)), (bytes(92), ...)])
def test_a_binary_stl_file_is_detected_by_its_length(header, behind, notes):
    assert check(binary(header, behind=behind)) == (("92 bytes after the end skipped",) if notes is ... else notes)


def test_nan_normals_of_stl_are_ignored():
    assert check(binary(normals=np.nan, behind=b"more")) == ("4 bytes after the end skipped",)


@pytest.mark.parametrize(
    "data",
    [
        TEXT,
        "\ufeff" + TEXT,
        TEXT.replace("\n", "\r\n"),
        TEXT.replace("\n", "\r"),
        TEXT.upper(),
        TEXT.replace("\n", "\n\n \t"),
        TEXT.replace("part", "a facet of vertex 1 2"),
        TEXT.replace("endsolid part", "end solid part"),
        TEXT.replace("endsolid part", "endsolid"),
        TEXT.replace("endfacet", "end facet").replace("endloop", "end loop"),
        TEXT.replace("part", ""),
        TEXT.replace("\n", " "),
        TEXT.replace("\n  outer", " outer"),
        TEXT.replace("normal 0 0 1", "normal nan nan nan"),
        TEXT.replace("  outer loop", "  # a comment\n color 1 0 0\n  outer loop"),
        TEXT.encode() + b"\0\0",
        f"solid one\n{facet(CORNERS[0])}endsolid one\nsolid two\n{facet(CORNERS[1])}endsolid two\n",
    ],
)
def test_variants_of_a_text_stl_file_give_the_same_mesh(data):
    assert check(data) == ()


@pytest.mark.parametrize(
    ("data", "note"),
    [
        (TEXT[: TEXT.index("endsolid")], "no end"),
        (TEXT + "solid two\n", "no end"),
        (TEXT.removeprefix("solid part\n"), "no beginning"),
        (TEXT.replace(" facet", " hello\n facet"), "2 unknown lines skipped"),
    ],
)
def test_skipped_parts_of_an_stl_file_are_noted(data, note):
    (reported,) = check(data, "stl")
    assert note in reported


def test_a_facet_of_four_corners_is_cut_as_a_polygon():
    mesh = parsed(f"solid\n{facet(np.array([[2, 0, 0], [0.5, 0.5, 0], [0, 2, 0], [0, 0, 0]]))}endsolid\n")
    assert len(mesh.vertices) == 4
    assert mesh.faces.tolist() == [[1, 2, 3], [1, 3, 0]]
    assert mesh.notes == ("1 facet of more than three corners cut into triangles",)


@pytest.mark.parametrize(
    ("data", "error", "message"),
    [
        (binary(count=3), MeshReadError, "announces 3 facets, but has 2"),
        (binary()[:-1], MeshReadError, "announces 2 facets, but has 1"),
        (binary(b"part")[:70], MeshReadError, "70 bytes, while the header alone has 84"),
        (binary(b"solid x", count=3), MeshReadError, "announces 3 facets, but has 2"),
        (binary(count=0)[:84], MeshReadError, "no triangles"),
        (binary(count=0), MeshReadError, "announces 0 facets, but has 2"),
        (20 * "a page of text\n", MeshReadError, "is text, but does not begin with a facet"),
        ("a page\n", MeshReadError, "does not begin with a solid"),
        ("solid x\nendsolid x\n", MeshReadError, "no triangles"),
        (
            TEXT.replace("vertex 1.000000e+00 1", "vertx 1.000000e+00 1"),
            MeshReadError,
            "line 10: a facet has only 2 of three",
        ),
        (
            TEXT.replace("5.000000e-01", "0,5"),
            MeshReadError,
            "line 12: three coordinates expected, found 'vertex .* 0,5'",
        ),
        (TEXT.replace("5.000000e-01", ""), MeshReadError, "line 12: three coordinates"),
        (
            TEXT[: TEXT.rindex("   vertex")],
            MeshReadError,
            "line 9: a facet has only 2 of three|line 10: a facet has only 2",
        ),
        (TEXT.replace(" endfacet\n facet normal 0 0 1\n  outer loop\n", ""), MeshReadError, "outside a facet"),
        (TEXT.encode("utf-16"), MeshFormatError, "UTF-16"),
    ],
)
def test_errors_in_an_stl_file_are_reported(data, error, message):
    with pytest.raises(error, match=message):
        read_mesh(data if isinstance(data, bytes) else data.encode(), file_type="stl")


@given(st.integers(12, len(TEXT) - 20))
def test_a_truncated_text_stl_file_is_an_error_or_has_a_note(length):
    try:
        mesh = parsed(TEXT[:length], "stl")
    except (MeshReadError, MeshFormatError):
        return
    assert mesh.notes or not len(mesh.faces)


@given(st.binary(min_size=90, max_size=400))
def test_random_bytes_are_not_detected_as_stl(data):
    count = struct.unpack_from("<I", data, 80)[0]
    if len(data) != 84 + 50 * count:
        with pytest.raises(MeshFormatError):
            detect_format(data.replace(b"v", b"w").replace(b"f", b"g").replace(b"V", b"W").replace(b"F", b"G"))
