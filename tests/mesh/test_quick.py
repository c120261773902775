"""Plain obj and off files are read quickly, and just as others are: a comment sends a file the careful way."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from unbend.mesh.formats.quick import QUICK

from unbend import read_mesh
from unbend.errors import MeshError

OFF = b"OFF\n5 3 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n0 0 1.5\n3 0 1 2\n3 0 2 3\n3 0 1 4\n"
OBJ = b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 1\nv 0 0 1.5\nf 1/1 2/1 3/1\nf 1 3 4\nf 1//1 2 5/1/1\n"
CAREFUL = {"off": b"\n# comment\n", "obj": b"\n# \\ \n"}


@pytest.mark.parametrize(("kind", "data"), [("off", OFF), ("obj", OBJ)])
def test_plain_files_go_the_quick_way_and_comments_the_other(kind, data):
    assert QUICK[kind](data) is not None
    assert QUICK[kind](data + CAREFUL[kind]) is None


def outcome(data: bytes, kind: str):
    try:
        surface = read_mesh(data, file_type=kind)
    except MeshError as error:
        return type(error), str(error)
    return surface.vertices.tolist(), surface.faces.tolist(), surface.report.notes


@settings(max_examples=300)
@given(st.sampled_from([("off", OFF), ("obj", OBJ)]), st.data())
def test_damaged_files_end_alike(plain, draw):
    kind, data = plain[0], bytearray(plain[1])
    for _ in range(draw.draw(st.integers(1, 4))):
        position = draw.draw(st.integers(0, len(data) - 1))
        change = draw.draw(st.sampled_from([b"", b" ", b"\n", b"-", b".", b"/", b"7", b"e", b"nan", b"v", b"f 1 2\n"]))
        data[position : position + draw.draw(st.integers(0, 3))] = change
        if not data:
            return
    assert outcome(bytes(data), kind) == outcome(bytes(data) + CAREFUL[kind], kind)


@pytest.mark.parametrize(
    "line", [b"v 4 5\n", b"v 1 2 3 4\n", b"v 1 2 3 -4611686018427387904\nv 1 2\n", b"v 1e400 0 0\n", b"v 0x1 0 0\n"]
)
def test_lines_of_other_lengths_are_never_taken_for_plain_ones(line):
    assert outcome(line + OBJ, "obj") == outcome(line + OBJ + CAREFUL["obj"], "obj")


def test_real_files_are_the_same_either_way(labelled):
    for path, _ in labelled("single"):
        kind = path.suffix[1:]
        if kind in QUICK and (plain := QUICK[kind](path.read_bytes())):
            careful = read_mesh(path.read_bytes() + CAREFUL[kind], file_type=kind)
            np.testing.assert_array_equal(careful.vertices, plain[0])
            assert careful.report.faces == len(plain[1])
