"""obj files in all variants that the format allows and other programs write."""

from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from unbend import read_mesh
from unbend.errors import MeshReadError

POINTS = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1.5]]
TRIANGLES = [[0, 1, 2], [0, 2, 3], [0, 1, 4]]
ROWS = "".join(f"v {x} {y} {z}\n" for x, y, z in POINTS)
FACES = "f 1 2 3\nf 1 3 4\nf 1 2 5\n"
PLAIN = ROWS + FACES


def check(data: str | bytes) -> tuple[str, ...]:
    """Check that a file has the mesh of `PLAIN`; return its notes, except the notes of `PLAIN` itself."""
    surface = read_mesh(data if isinstance(data, bytes) else data.encode(), file_type="obj")
    np.testing.assert_array_equal(surface.vertices, POINTS)
    np.testing.assert_array_equal(surface.faces, TRIANGLES)
    return tuple(note for note in surface.report.notes if note not in read_mesh(PLAIN.encode()).report.notes)


def behind(rows: str, more: str) -> str:
    return "".join(f"{line}{more}\n" for line in rows.splitlines())


@pytest.mark.parametrize(
    "data",
    [
        "\ufeff" + PLAIN,
        "mtllib C:\\models\\\n" + PLAIN,
        PLAIN.replace("f 1 2 5", "usemtl C:\\red\\ \n\tf 1 2 5"),
        PLAIN.replace("f 1 2 5", "g head \\\nv f \\\nbody\nf 1 2 5"),
        PLAIN.replace("\n", "\r\n"),
        PLAIN.replace("\n", "\r"),
        PLAIN.upper(),
        PLAIN.replace(" ", "\t"),
        PLAIN.replace("v", " \tv"),
        PLAIN.replace("\n", " \n\n"),
        PLAIN.encode() + b"\0\0\0",
        PLAIN.encode() + b"\x1a",
        PLAIN[:-1],
        FACES + ROWS,
        behind(PLAIN, " # here"),
        behind(PLAIN, "# here \\"),
        "# C:\\models\\\n" + PLAIN,
        PLAIN.replace(" 2", " \\\n2"),
        PLAIN.replace(" 2", " \\ \t\r\n 2"),
        behind(ROWS, " 1.0") + FACES,
        behind(ROWS, " 0.5 0.5 0.5") + FACES,
        ROWS.replace("1.5", "1.5 1 0 0") + FACES,
        ROWS + FACES.replace("f", "fo"),
        ROWS + "f 1/7/7 2/7/7 3/7/7\nf 1//7 3//7 4//7\nf 1/7 2/ 5//\n",
        ROWS + "f -5 -4 -3\nf -5 3 4\nf 1 2 -1\n",
        "v 0 0 0\nv 1 0 0\nv 1 1 0\nf -3 -2 -1\nv 0 1 0\nf 1 3 -1\nv 0 0 1.5\nf -5 2 -1\n",
        "mtllib a b.mtl\no v 1\ng f 1 2 3\n" + ROWS + "vt 0 0\nvn 0 0 1\nvp 1\nusemtl v\ns off\nl 1 2\np 1\n" + FACES,
    ],
)
def test_variants_of_an_obj_file_give_the_same_mesh(data):
    assert check(data) == ()


@pytest.mark.parametrize(
    ("data", "note"),
    [
        (PLAIN + "f 1 2\nf 3\nf\n", "3 faces of fewer than three corners skipped"),
        (behind(ROWS, " 0.5 red") + FACES, "words that are not numbers skipped at the end of 5 lines"),
        ("# head\nteapot 1\n" + PLAIN, "lines skipped that begin with 'teapot'"),
        (PLAIN + "".join(f"word{i}\n" for i in range(9)), "and 4 other words"),
    ],
)
def test_skipped_parts_of_an_obj_file_are_noted(data, note):
    (reported,) = check(data)
    assert note in reported


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (PLAIN.replace("v 1 1 0", "v 1 1"), "line 3: three coordinates expected, found 'v 1 1'"),
        (PLAIN.replace("v 1 1 0", "v"), "line 3: three coordinates"),
        (PLAIN.replace("v 1 1 0", "v 1 1,5 0"), "line 3: three coordinates"),
        (PLAIN.replace("v 1 1 0", "v 1 1-2"), "line 3: three coordinates"),
        (PLAIN.replace("v 1 1 0", "v 1 0x1 0"), "line 3: three coordinates"),
        (PLAIN.replace("v 1 1 0\n", "v 1 1 0 "), "line 3: three coordinates"),
        (PLAIN.replace("v 0 0 1.5", "v 0 0 \\\n1,5"), "line 5: three coordinates"),
        (PLAIN.replace("v 1 0 0", "v 1 0 \\\n0").replace("f 1 2 5", "f 1 2 x"), "line 9: .* found 'f 1 2 x'"),
        (PLAIN.replace("f 1 2 5", "f 1 2 /5"), "line 8: a corner has no vertex"),
        (PLAIN.replace("f 1 2 5", "f 1 2 5.5"), "line 8: 5.5 is not the index of a vertex"),
        (PLAIN.replace("f 1 2 5", "f 1 2 99999999999999999999"), "line 8: .* is not the index of a vertex"),
        (PLAIN.replace("f 1 2 5", "f 0 1 2"), "line 8: .* first vertex of an obj file is 1"),
        ("f -1 -2 -3\n" + ROWS, "line 1: a face uses vertex -1, which is before"),
        ("# nothing but words\nvt 0 0\n", "no line that begins with v or f"),
        ("\x7fELF\2\1\1\0\0\0", "no line that begins with v or f"),
    ],
)
def test_errors_in_an_obj_file_are_reported(data, message):
    with pytest.raises(MeshReadError, match=message):
        read_mesh(data.encode(), file_type="obj")


@given(st.lists(st.sampled_from([" ", "\t", "  ", " \\\n", "\\\n", "\\ \n\t"]), min_size=8, max_size=30))
def test_words_may_be_separated_by_any_blanks_and_continued_lines(blanks):
    parts = PLAIN.split(" ")
    assert check("".join(part + blanks[i % len(blanks)] for i, part in enumerate(parts)).rstrip(" \\\t")) == ()


def test_many_polygons_are_read_in_seconds():
    number = 100_000
    rows = "".join(f"v {i} {i % 7} 0\n" for i in range(number + 3))
    faces = "".join(f"f {i} {i + 1} {i + 2} {i + 3}\nf {i}/1 {i + 1}/1 {i + 2}/1\n" for i in range(1, number))
    begun = time.process_time()
    assert read_mesh((rows + faces).encode()).report.faces == 3 * (number - 1)
    assert time.process_time() - begun < 15
