"""Writing meshes: unbend and trimesh read the written files correctly."""

from __future__ import annotations

import io

import numpy as np
import pytest
import trimesh

from unbend import read_mesh
from unbend.errors import ParameterError
from unbend.mesh.write import write_mesh

VERTICES = np.array([[0, 0, 0], [1, 0, 1 / 3], [0, 1, 0], [1, 1, -1e-7]])
FACES = np.array([[0, 1, 2], [1, 3, 2]], np.int32)
COLOURS = np.array([[0, 0.5, 1], [1, 0, 0], [0.2, 0.4, 0.6], [1, 1, 1]])
UV = np.array([[0, 0], [1, 0], [0, 0.25], [1, 0.25]])


def loaded(data: bytes, file_type: str) -> trimesh.Trimesh:
    return trimesh.load(io.BytesIO(data), file_type=file_type, process=False, force="mesh")


@pytest.mark.parametrize("file_type", ["obj", "off"])
@pytest.mark.parametrize("factor", [1e-30, 1.0, 1e30])
@pytest.mark.parametrize("coloured", [False, True])
def test_text_formats_keep_every_digit_at_every_scale(file_type, factor, coloured):
    data = write_mesh(factor * VERTICES, FACES, file_type, colours=COLOURS if coloured else None)
    for found in (read_mesh(data), loaded(data, file_type)):
        np.testing.assert_array_equal(found.vertices, factor * VERTICES)
        np.testing.assert_array_equal(found.faces, FACES)


@pytest.mark.parametrize("file_type", ["ply", "obj", "glb"])
def test_trimesh_reads_the_written_colours(file_type):
    found = loaded(write_mesh(VERTICES, FACES, file_type, colours=COLOURS), file_type)
    np.testing.assert_allclose(found.visual.vertex_colors[:, :3] / 255, COLOURS, atol=1 / 255)


def test_a_coloured_off_file_is_a_coff_file_with_integer_colours():
    lines = write_mesh(VERTICES, FACES, "off", colours=COLOURS).decode().splitlines()
    assert lines[:2] == ["COFF", "4 2 0"]
    assert lines[2] == "0.0 0.0 0.0 0 128 255 255"
    assert lines[6] == "3 0 1 2"
    assert len(lines) == 8


def test_obj_texture_coordinates_are_written_per_corner_without_a_material_file():
    text = write_mesh(VERTICES, FACES, "obj", uv=UV).decode()
    assert "vt 1.0 0.25\n" in text
    assert text.endswith("f 1/1 2/2 3/3\nf 2/2 4/4 3/3\n")
    assert "mtl" not in text


@pytest.mark.parametrize("file_type", ["obj", "glb"])
def test_trimesh_reads_the_written_texture_coordinates(file_type):
    data = write_mesh(VERTICES, FACES, file_type, uv=UV)
    np.testing.assert_allclose(loaded(data, file_type).visual.uv, UV, atol=1e-7)
    np.testing.assert_array_equal(read_mesh(data).faces, FACES)


@pytest.mark.parametrize("file_type", ["ply", "off"])
def test_texture_coordinates_are_refused_in_formats_without_them(file_type):
    with pytest.raises(ParameterError, match="obj, glb"):
        write_mesh(VERTICES, FACES, file_type, uv=UV)


@pytest.mark.parametrize("file_type", ["ply", "obj", "off", "glb", "json"])
def test_coordinates_that_are_not_finite_become_zero(file_type):
    vertices = np.vstack([VERTICES, [[np.nan, np.inf, 1.0]]])
    uv = np.vstack([UV, [[np.nan, np.nan]]]) if file_type in {"obj", "glb"} else None
    data = write_mesh(vertices, FACES, file_type, uv=uv)
    assert b"nan" not in data.lower().replace(b"binary", b"")
    if file_type != "json":
        np.testing.assert_array_equal(read_mesh(data).vertices[4], [0, 0, 1])
