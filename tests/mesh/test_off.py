"""off files in all variants that Geomview's format allows and other programs write."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from unbend import read_mesh
from unbend.errors import MeshError, MeshFormatError, MeshReadError, MeshTooLargeError
from unbend.mesh.limits import MeshLimits

POINTS = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1.5]]
TRIANGLES = [[0, 1, 2], [0, 2, 3], [0, 1, 4]]
ROWS = "".join(f"{x} {y} {z}\n" for x, y, z in POINTS)
FACES = "3 0 1 2\n3 0 2 3\n3 0 1 4\n"
PLAIN = f"OFF\n5 3 0\n{ROWS}{FACES}"


def behind(rows: str, more: str) -> str:
    return "".join(f"{line} {more}\n" for line in rows.splitlines())


def check(data: str | bytes) -> tuple[str, ...]:
    """Check that a file has the mesh of `PLAIN`; return its notes, except the notes of `PLAIN` itself."""
    surface = read_mesh(data if isinstance(data, bytes) else data.encode(), file_type="off")
    np.testing.assert_array_equal(surface.vertices, POINTS)
    np.testing.assert_array_equal(surface.faces, TRIANGLES)
    return tuple(note for note in surface.report.notes if note not in read_mesh(PLAIN.encode()).report.notes)


@pytest.mark.parametrize(
    "data",
    [
        PLAIN.lower(),
        PLAIN.replace("\n", "\r\n"),
        PLAIN.replace("\n", "\r"),
        "\ufeff" + PLAIN,
        PLAIN[4:],
        PLAIN.replace("OFF\n", "OFF"),
        PLAIN.replace("OFF\n", "OFF "),
        PLAIN.replace("OFF", "# first\n\n  OFF # second"),
        PLAIN.replace("5 3 0", "5 3"),
        PLAIN.replace("5 3 0", "5\n# here\n3 # and here\n0"),
        PLAIN.replace("5 3 0", "5 3 0 # and\n"),
        behind(PLAIN, "# here"),
        PLAIN.replace("\n", "\n\n \t\n"),
        PLAIN.replace("\n", " "),
        PLAIN.replace(" ", "\n"),
        f"OFF 5 3 0 {ROWS}{FACES}",
        f"OFF\n5 3 0\n{ROWS.replace(chr(10), ' ')}\n{FACES}",
        f"OFF\n5 3 0\n{ROWS}{FACES.replace(chr(10), ' ')}",
        f"OFF\n5 3 0\n{ROWS}{behind(FACES, '255 0 0')}",
        f"OFF\n5 3 0\n{ROWS}{behind(FACES, '0.5 0.5 0.5 1.0')}",
        f"OFF\n5 3 0\n{ROWS}{behind(FACES, '7')}",
        f"OFF\n5 3 0\n{ROWS.replace(chr(10), ' ')}\n{behind(FACES, '255 0 0')}",
        f"OFF\n5 3 0\n{behind(ROWS, '0.1 0.2 0.3')}{FACES}",
        f"COFF\n5 3 0\n{behind(ROWS, '255 0 0 255')}{FACES}",
        f"COFF\n5 3 0\n{behind(ROWS, '255 0 0')}{behind(FACES, '1 1 1')}",
        f"COFF\n5 3 0\n{behind(ROWS, '255 0 0 255').replace(chr(10), ' ')}{FACES}",
        f"COFF\n5 3 0\n{behind(ROWS, '255 0 0').replace(chr(10), ' ')}{FACES}",
        f"NOFF\n5 3 0\n{behind(ROWS, '0 0 1').replace(chr(10), ' ')}{FACES}",
        f"noff\n5 3 0\n{behind(ROWS, '0 0 1').replace(chr(10), ' ')}{FACES}",
        f"STCNOFF\n5 3 0\n{behind(ROWS, '0 0 1 255 0 0 255 0.5 0.5').replace(chr(10), ' ')}{FACES}",
        f"4OFF\n5 3 0\n{behind(ROWS, '1')}{FACES}",
        f"4OFF\n5 3 0\n{behind(ROWS, '1').replace(chr(10), ' ')}{FACES}",
        f"nOFF\n3\n5 3 0\n{ROWS}{FACES}",
        f"nOFF 3 5 3 0\n{ROWS}{FACES}",
    ],
)
def test_variants_of_an_off_file_give_the_same_mesh(data):
    assert check(data) == ()


@given(st.lists(st.sampled_from(["\n", " ", "\t", "\r\n", " \n\n", "  "]), min_size=27, max_size=60))
def test_lines_may_break_anywhere(blanks):
    words = PLAIN.split()
    assert check("".join(word + blanks[i % len(blanks)] for i, word in enumerate(words))) == ()


@pytest.mark.parametrize(
    ("data", "note"),
    [
        (
            f"OFF\n5 3 0\n{behind(ROWS, '#')}{behind(FACES, 'red')}",
            "words that are not numbers skipped at the end of 3 lines",
        ),
        (f"COFF\n5 3 0\n{behind(ROWS, '1_0 0 0')}{FACES}", "words that are not numbers skipped at the end of 5 lines"),
        (PLAIN + "the end\n", "1 line after the end skipped"),
        (PLAIN + "3 0 1 2\n\n3 0 1 2\n", "2 lines after the end skipped"),
        (PLAIN.replace("5 3", "5 6") + "2 0 1\n1 0\n0\n", "3 faces of fewer than three corners skipped"),
    ],
)
def test_skipped_parts_of_an_off_file_are_noted(data, note):
    assert check(data) == (note,)


def test_the_fourth_coordinate_divides_the_others():
    half = "".join(f"{2 * x} {2 * y} {2 * z} 2\n" for x, y, z in POINTS)
    assert check(f"4OFF\n5 3 0\n{half}{FACES}") == ()


def binary(key: str = "OFF", columns: int = 3, faces: list[list[int]] = TRIANGLES, colours: int = 0) -> bytes:
    points = np.ones((5, columns))
    points[:, :3] = POINTS
    body = b"".join(
        struct.pack(f">{len(face) + 1}i", len(face), *face) + struct.pack(f">i{colours}f", colours, *(0.5,) * colours)
        for face in faces
    )
    return f"{key} BINARY\n".encode() + struct.pack(">3i", 5, len(faces), 0) + points.astype(">f4").tobytes() + body


@pytest.mark.parametrize(
    "data",
    [
        binary(),
        binary(colours=4),
        binary("COFF", 7),
        binary("4OFF", 4),
        binary("nOFF").replace(b"BINARY\n", b"BINARY\n\0\0\0\3"),
        b"# by hand\n" + binary("off"),
    ],
)
def test_variants_of_a_binary_off_file_give_the_same_mesh(data):
    assert check(data) == ()


def test_polygons_in_a_binary_off_file_are_read_and_skipped_parts_noted():
    surface = read_mesh(binary(faces=[[0, 1, 2, 3], [0, 1], [0, 1, 4]]) + b"more")
    np.testing.assert_array_equal(surface.faces, TRIANGLES)
    for note in ("4 bytes after the end skipped", "1 face of fewer than three corners skipped"):
        assert note in surface.report.notes


@pytest.mark.parametrize(
    ("data", "error", "message"),
    [
        (binary()[:-1], MeshReadError, "ends early"),
        (binary()[:15], MeshReadError, "before its counts"),
        (binary(faces=[[0, 1, 5]]), MeshReadError, "face 0: a face uses vertex 5"),
        (binary(faces=[[0, 1, -1]]), MeshReadError, "face 0: a face uses vertex -1"),
        (b"nOFF BINARY\n\0\0\0\4" + binary()[11:], MeshFormatError, "not three-dimensional"),
        (f"nOFF\n4\n5 3 0\n{behind(ROWS, '1')}{FACES}".encode(), MeshFormatError, "not three-dimensional"),
        (PLAIN.replace("5 3 0", "-5 3 0").encode(), MeshReadError, "line 2: a count is negative"),
        (PLAIN.replace("5 3 0", "5.5 3 0").encode(), MeshReadError, "line 2: the counts"),
        (PLAIN.replace("3 0 1 2", "3 0 1 2.5").encode(), MeshReadError, "line 8: 2.5 is not the index of a vertex"),
        (PLAIN.replace("3 0 1 2", "3 0 -1 2").encode(), MeshReadError, "line 8: a face uses vertex -1"),
        (PLAIN.replace("3 0 1 2", "1e9 0 1 2").encode(), MeshReadError, "line 8: a face has 3 of 1000000000 corners"),
        (PLAIN.replace("1 1 0", "1 1-2 0").encode(), MeshReadError, "line 5: .* found '1 1-2 0'"),
        (PLAIN.replace("1 1 0", "1 1,5 0").encode(), MeshReadError, "line 5: .* found '1 1,5 0'"),
        (PLAIN.replace("5 3 0", "6 3 0").encode(), MeshReadError, "ends early"),
        (b"4OFF\n5 3 0\n" + ROWS.encode() + FACES.encode(), MeshReadError, "four coordinates"),
    ],
)
def test_errors_in_an_off_file_are_reported(data, error, message):
    with pytest.raises(error, match=message):
        read_mesh(data, file_type="off")


@given(st.integers(0, len(PLAIN) - 2))
def test_a_file_that_ends_early_is_never_a_smaller_mesh(length):
    with pytest.raises(MeshError):
        read_mesh(PLAIN[:length].rstrip().encode(), file_type="off")


def test_counts_beyond_the_limits_are_refused():
    for data in (PLAIN.encode(), PLAIN[4:].encode(), binary()):
        with pytest.raises(MeshTooLargeError):
            read_mesh(data, file_type="off", limits=MeshLimits(vertices=4))
