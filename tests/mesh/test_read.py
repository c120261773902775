"""Reading meshes: formats, the order and joining of vertices, and typed errors for damaged files."""

from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from unbend import MeshPolicy, read_mesh
from unbend.errors import MeshError, MeshFormatError, MeshGeometryError, MeshReadError
from unbend.mesh.shapes import sphere
from unbend.mesh.write import write_mesh

VERTICES = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1.5]])
FACES = np.array([[0, 1, 2], [0, 2, 3], [0, 1, 4]], np.int32)
OFF = b"OFF\n# a comment\n5 3 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n0 0 1.5\n3 0 1 2\n3 0 2 3 255 0 0\n3 0 1 4\n"
OBJ = b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1.5\nf 1 2 3\nf 1 3 4\nf 1 2 5\n"


@pytest.mark.parametrize("file_type", ["off", "obj", "ply", "glb"])
def test_every_format_keeps_the_order_of_vertices_and_faces(file_type):
    surface = read_mesh(write_mesh(VERTICES, FACES, file_type))
    assert surface.report.file_type == file_type
    np.testing.assert_allclose(surface.vertices, VERTICES, atol=1e-7)
    np.testing.assert_array_equal(surface.faces, FACES)


def test_copies_of_vertices_in_stl_are_joined():
    import trimesh

    data = trimesh.Trimesh(VERTICES, FACES, process=False).export(file_type="stl")
    surface = read_mesh(data)
    assert len(surface.vertices) == 5
    assert surface.report.components == 1
    np.testing.assert_array_equal(surface.vertices[surface.faces], VERTICES[FACES].astype(np.float32))
    np.testing.assert_array_equal(surface.vertices, VERTICES.astype(np.float32))  # in order of appearance


def test_text_stl_is_read():
    text = (
        b"solid s\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"
        b"endsolid s\n"
    )
    assert len(read_mesh(text).faces) == 1


SOLID = (
    b"solid one\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"
    b"endsolid one\n"
)


def test_all_solids_of_an_stl_file_are_one_surface():
    other = SOLID.replace(b"0 0 0", b"1 1 0").replace(b"\n", b"\r\n").upper()
    surface = read_mesh(SOLID + other)
    np.testing.assert_array_equal(surface.vertices, [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    np.testing.assert_array_equal(surface.faces, [[0, 1, 2], [3, 1, 2]])
    begun = time.process_time()
    assert read_mesh(SOLID * 5000).report.faces == 5000
    assert time.process_time() - begun < 4  # reading each solid as a mesh took 10 seconds


def test_a_path_and_a_binary_file_are_read_like_bytes(tmp_path):
    path = tmp_path / "mesh.off"
    path.write_bytes(OFF)
    with path.open("rb") as file:
        sources = [read_mesh(path), read_mesh(str(path)), read_mesh(file), read_mesh(OFF)]
    for surface in sources:
        np.testing.assert_array_equal(surface.vertices, VERTICES)


def test_copies_of_a_vertex_at_a_seam_are_joined_unless_seams_are_kept():
    doubled = OBJ + b"v 0 0 0\nv 0 2 0\nf 6 4 7\nf 4 3 7\n"
    surface = read_mesh(doubled)
    assert surface.report.seams == 1
    np.testing.assert_array_equal(surface.vertex_map, [0, 1, 2, 3, 4, 0, 5])
    cut = read_mesh(doubled, policy=MeshPolicy(seams="keep"))
    assert (len(cut.vertices), cut.faces.max(), cut.vertex_map) == (7, 6, None)


def test_textures_and_materials_of_obj_do_not_split_vertices():
    data = (
        b"mtllib no.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 1\nvn 0 0 1\no first\nusemtl red\n"
        b"f 1/1/1 2/2/1 3/1/1\ng second\nusemtl blue\nf -4/2 -2/1 -1/2\n"
    )
    surface = read_mesh(data)
    assert len(surface.vertices) == 4
    np.testing.assert_array_equal(surface.faces, [[0, 1, 2], [0, 2, 3]])


@pytest.mark.parametrize(
    "data", [b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n", b"OFF\n4 1 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n"]
)
def test_polygons_become_triangles_of_the_same_area(data):
    surface = read_mesh(data)
    assert len(surface.faces) == 2
    assert surface.area == pytest.approx(1.0)


def test_pentagons_and_triangles_can_be_mixed():
    data = b"v 0 0 0\nv 2 0 0\nv 2 1 0\nv 1 2 0\nv 0 1 0\nv 3 0 0\nf 1 2 3 4 5\nf 2 6 3\n"
    assert read_mesh(data).area == pytest.approx(3.5)


def test_the_content_of_a_file_decides_about_its_format():
    assert read_mesh(OFF, file_type="ply").report.file_type == "off"


@pytest.mark.parametrize(
    ("data", "error", "message"),
    [
        (b"", MeshFormatError, "empty"),
        (b"PK\x03\x04 a zip file", MeshFormatError, "zip"),
        (b"\x89PNG", MeshFormatError, "a picture"),
        (b"\x00\x01\x02", MeshFormatError, "format of the file is unknown"),
        (OFF.replace(b"1 1 0\n", b"1 1\n"), MeshReadError, "line 6"),
        (OFF.replace(b"1.5", b"abc"), MeshReadError, "line 8"),
        (OFF[: OFF.index(b"3 0 1 4")], MeshReadError, "ends early"),
        (b"OFF\nfive 3 0\n", MeshReadError, "line 2"),
        (b"OFF\n", MeshReadError, "counts"),
        (OFF.replace(b"3 0 1 4", b"3 0 1 9"), MeshReadError, "line 11"),
        (OFF.replace(b"3 0 1 4", b"4 0 1 4"), MeshReadError, "line 11: a face has 3 of 4 corners"),
        (OBJ.replace(b"f 1 2 5", b"f 1 2 x"), MeshReadError, "line 8"),
        (OBJ.replace(b"f 1 2 5", b"f 1 2 0"), MeshReadError, "line 8: a face uses vertex 0"),
        (OBJ.replace(b"f 1 2 5", b"f 1 2 99"), MeshReadError, "line 8: a face uses vertex 99"),
        (OBJ.replace(b"f 1 2 5", b"f 1 2 -9"), MeshReadError, "before the first"),
        (OBJ.replace(b"v 0 0 0", b"v nan 0 0"), MeshGeometryError, "vertex 0 .*not finite"),
        (OBJ.replace(b"v 0 0 0", b"v 1.#QNAN -1.#INF -1.#IND00"), MeshGeometryError, r"vertex 0 .*\[nan, -inf, nan\]"),
        (OBJ.replace(b"v 0 0 0", b"v 0 -inf 0"), MeshGeometryError, "vertex 0 .*not finite"),
        (b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", MeshReadError, "no triangles"),
        (b"v 0 0 0\nv 0 0 0\nv 0 0 0\nf 1 2 3\n", MeshGeometryError, "zero area"),
        (b"v 0 0 0\nv 1 0 0\nv 0 0 0\nf 1 2 2\n", MeshGeometryError, "three different"),
        (b"ply\nformat ascii 1.0\nelement vertex 3\n", MeshReadError, "ply"),
        (b"glTF\x02\x00\x00\x00garbage", MeshReadError, "glb"),
    ],
)
def test_damaged_files_raise_typed_errors_with_the_place(data, error, message):
    with pytest.raises(error, match=message):
        read_mesh(data)


def test_only_the_largest_component_is_kept_with_unchanged_indices():
    data = b"v 9 9 9\nv 9.1 9 9\nv 9 9.1 9\nf 1 2 3\n" + b"".join(
        line + b"\n" if line.startswith(b"v") else line.replace(b" 1 ", b" 4 ").replace(b"2 ", b"5 ") + b"\n"
        for line in (b"v 0 0 0", b"v 1 0 0", b"v 1 1 0", b"f 1 2 6")
    )
    surface = read_mesh(data)
    np.testing.assert_array_equal(surface.faces, [[3, 4, 5]])
    assert len(surface.vertices) == 6
    assert surface.report.components == 2
    with pytest.raises(MeshGeometryError, match="2 components"):
        read_mesh(data, policy=MeshPolicy(components="error"))


@given(st.sampled_from([OFF, OBJ, write_mesh(VERTICES, FACES, "ply"), write_mesh(VERTICES, FACES, "glb")]), st.data())
def test_any_damage_gives_a_surface_or_a_typed_error(data, draw):
    damaged = bytearray(data)
    for _ in range(draw.draw(st.integers(1, 4))):
        position = draw.draw(st.integers(0, len(damaged) - 1))
        kind = draw.draw(st.sampled_from(["cut", "change", "repeat"]))
        if kind == "cut":
            del damaged[position : position + draw.draw(st.integers(1, 30))]
        elif kind == "change":
            damaged[position] = draw.draw(st.integers(0, 255))
        else:
            damaged[position:position] = damaged[position : position + 10]
        if not damaged:
            break
    try:
        surface = read_mesh(bytes(damaged))
    except MeshError:
        return
    assert np.isfinite(surface.vertices[surface.faces]).all()
    assert surface.area > 0


def test_reports_of_real_meshes_equal_the_table(labelled):
    for dataset in ("single", "dirty", "tosca5k"):
        for path, row in labelled(dataset):
            report = read_mesh(path, policy=MeshPolicy(components="bridge", seams="keep")).report
            assert (report.vertices, report.faces) == (int(row["nv"]), int(row["nf"])), path.name
            assert report.components == int(row["components"]), path.name
            if not report.duplicate_faces:  # the table also counts edges of duplicate faces
                for name in ("boundary_edges", "nonmanifold_edges", "nonmanifold_vertices"):
                    assert getattr(report, name) == int(row[name]), (path.name, name)


def test_a_file_is_simplified_by_its_policy():
    ball = sphere(3)
    surface = read_mesh(write_mesh(ball.vertices, ball.faces, "ply"), policy=MeshPolicy(max_vertices=100))
    assert len(surface.vertices) <= 100
    assert len(surface.vertex_map) == len(ball.vertices)
    assert surface.report.vertices == len(ball.vertices)
