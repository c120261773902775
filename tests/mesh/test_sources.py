"""Meshes in memory and open files, as `read_mesh`, `compute_signature` and libraries take them."""

from __future__ import annotations

import io
from dataclasses import dataclass

import meshio
import numpy as np
import pytest
import trimesh

from unbend import Library, Parameters, compute_signature, read_mesh
from unbend.errors import MeshGeometryError, MeshTooLargeError, ParameterError
from unbend.mesh.limits import MeshLimits
from unbend.mesh.shapes import torus
from unbend.mesh.sources import bytes_of

TORUS = torus(columns=10, rows=6)
FEW = {"samples": 20}


@dataclass
class Triangles:
    """A mesh with the attributes of Open3D's `TriangleMesh`."""

    vertices: np.ndarray
    triangles: np.ndarray


SOURCES = {
    "surface": lambda: TORUS,
    "arrays": lambda: (TORUS.vertices, TORUS.faces),
    "lists": lambda: (TORUS.vertices.tolist(), TORUS.faces.tolist()),
    "trimesh": lambda: trimesh.Trimesh(TORUS.vertices, TORUS.faces, process=False),
    "open3d": lambda: Triangles(TORUS.vertices, TORUS.faces),
    "meshio": lambda: meshio.Mesh(TORUS.vertices, [("triangle", TORUS.faces), ("line", [[0, 1]])]),
}


@pytest.mark.parametrize("name", SOURCES)
def test_a_mesh_in_memory_is_read_without_a_loss(name):
    found = read_mesh(SOURCES[name]())
    assert np.array_equal(found.vertices, TORUS.vertices)
    assert np.array_equal(found.faces, TORUS.faces)
    file = bytes_of(SOURCES[name]())
    again = read_mesh(file.data)
    assert (file.name, again.report.file_type) == ("", "ply")
    assert np.array_equal(again.vertices, TORUS.vertices)
    assert np.array_equal(again.faces, TORUS.faces)


def test_quads_of_meshio_are_cut():
    square = meshio.Mesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]], [("quad", [[0, 1, 2, 3]])])
    assert read_mesh(square).area == pytest.approx(1.0)


def test_signatures_of_files_are_those_of_their_surfaces(tmp_path):
    path = tmp_path / "ring.ply"
    path.write_bytes(bytes_of(TORUS).data)
    expected = compute_signature(TORUS, Parameters(**FEW))
    with path.open("rb") as file:
        for source in (path, str(path), path.read_bytes(), file):
            assert np.array_equal(compute_signature(source, FEW).points, expected.points)


def test_a_library_keeps_a_mesh_in_memory_as_a_file(tmp_path):
    with Library(str(tmp_path / "library.db")) as library:
        shape = library.add(TORUS, parameters=FEW, policy={"seams": "keep"})
        assert (shape.name, shape.file_type, shape.policy.seams) == ("unnamed", "ply", "keep")
        assert library.add((TORUS.vertices, TORUS.faces), parameters=FEW, policy={"seams": "keep"}).id == shape.id
        assert np.array_equal(read_mesh(library.mesh(shape.id)).vertices, TORUS.vertices)
        with (tmp_path / "ring 1.ply").open("w+b") as file:
            file.write(bytes_of(TORUS).data)
            file.seek(0)
            assert library.add(file, parameters={"samples": 30}).name == "ring 1"


@pytest.mark.parametrize(
    ("source", "error", "words"),
    [
        ({"vertices": 1}, ParameterError, "dict is no mesh"),
        (7, ParameterError, "int is no mesh"),
        ((["a"], [[0, 1, 2]]), ParameterError, "no arrays of numbers"),
        ((np.zeros((3, 2)), [[0, 1, 2]]), MeshGeometryError, r"vertices must be \(n, 3\)"),
        ((np.eye(3), [[0, 1, 5]]), MeshGeometryError, "face 0 uses vertices"),
        (meshio.Mesh(np.eye(3), [("line", [[0, 1]])]), MeshGeometryError, "no faces"),
        (io.StringIO("OFF"), ParameterError, "mode 'rb'"),
    ],
)
def test_what_is_no_mesh_is_refused_in_words(source, error, words):
    with pytest.raises(error, match=words):
        read_mesh(source)


def test_limits_hold_in_memory():
    with pytest.raises(MeshTooLargeError, match="more than 10 vertices"):
        read_mesh(TORUS, limits=MeshLimits(vertices=10))
