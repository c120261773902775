"""Real files and files of this package, compared with independent readers and writers."""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable
from pathlib import Path

import meshio
import numpy as np
import plyfile
import pymeshlab
import pytest
import trimesh

from unbend.mesh.formats.detect import detect_format
from unbend.mesh.formats.parsed import ParsedMesh
from unbend.mesh.formats.registry import REGISTRY
from unbend.mesh.limits import UNLIMITED
from unbend.mesh.shapes import torus
from unbend.mesh.write import write_mesh

Mesh = tuple[np.ndarray, np.ndarray]
TORUS = torus(columns=12, rows=9)
COLOURS = np.linspace(0, 1, 3 * len(TORUS.vertices)).reshape(-1, 3)


def parsed(path: Path) -> ParsedMesh:
    data = path.read_bytes()
    return REGISTRY[detect_format(data)].read(data, UNLIMITED)


def by_pymeshlab(path: Path) -> Mesh:
    meshes = pymeshlab.MeshSet(verbose=False)
    meshes.load_new_mesh(str(path))
    return meshes.current_mesh().vertex_matrix(), meshes.current_mesh().face_matrix()


def by_trimesh(path: Path) -> Mesh:
    mesh = trimesh.load(path, process=False, force="mesh")
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


def by_meshio(path: Path) -> Mesh:
    mesh = meshio.read(path)
    return mesh.points[:, :3], np.concatenate([block.data for block in mesh.cells if block.type == "triangle"])


def by_plyfile(path: Path) -> Mesh:
    data = plyfile.PlyData.read(path)
    points = np.column_stack([data["vertex"][axis] for axis in "xyz"])
    return points, np.vstack(data["face"]["vertex_indices"])


READERS: dict[Callable[[Path], Mesh], tuple[str, ...]] = {
    by_pymeshlab: ("off", "obj", "ply", "glb"),
    by_trimesh: ("off", "obj", "ply", "glb"),
    by_meshio: ("off", "obj", "ply"),
    by_plyfile: ("ply",),
}
"""Independent readers, and the formats that each of them reads."""


def areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    corners = vertices[faces]
    return np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2


def test_every_real_file_is_read_like_by_pymeshlab(shared_data):
    paths = sorted(path for path in shared_data.rglob("*") if path.suffix in {".off", ".obj"})
    assert len(paths) == 711
    for path in paths:
        mesh = parsed(path)
        vertices, faces = by_pymeshlab(path)
        size = np.abs(vertices).max()
        np.testing.assert_allclose(mesh.vertices, vertices, rtol=0, atol=1e-6 * size, err_msg=path.name)
        assert len(mesh.faces) == len(faces), path.name
        if path.name == "cube.off":  # a quad may be cut along either diagonal
            assert areas(mesh.vertices, mesh.faces).sum() == pytest.approx(areas(vertices, faces).sum())
        else:
            np.testing.assert_array_equal(mesh.faces, faces, err_msg=path.name)
        assert mesh.notes == (), path.name


def test_some_real_files_are_read_like_by_trimesh_and_meshio(shared_data):
    paths = sorted(path for path in shared_data.rglob("*") if path.suffix in {".off", ".obj"})[::15]
    for path in paths:
        mesh = parsed(path)
        area = areas(mesh.vertices, mesh.faces).sum()
        assert areas(*by_trimesh(path)).sum() == pytest.approx(area, rel=1e-9), path.name
        if path.suffix == ".off":  # meshio reads an obj file only if it has one normal for each vertex
            assert areas(*by_meshio(path)).sum() == pytest.approx(area, rel=1e-9), path.name


@pytest.mark.parametrize("read", READERS)
@pytest.mark.parametrize("coloured", [False, True])
def test_written_files_are_read_by_independent_readers(read, coloured, tmp_path):
    for kind in READERS[read]:
        if kind == "off" and coloured and read is by_meshio:
            continue  # meshio does not know COFF; the other two readers do
        path = tmp_path / f"torus.{kind}"
        path.write_bytes(write_mesh(TORUS.vertices, TORUS.faces, kind, colours=COLOURS if coloured else None))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)
            vertices, faces = read(path)
        mesh = parsed(path)
        for found, found_faces in ((vertices, faces), (mesh.vertices, mesh.faces)):
            np.testing.assert_allclose(found, TORUS.vertices, atol=1e-6)
            np.testing.assert_array_equal(found_faces, TORUS.faces)


def written_by_trimesh(kind: str, ascii_: bool) -> bytes:
    mesh = trimesh.Trimesh(TORUS.vertices, TORUS.faces, process=False)
    options = {"encoding": "ascii" if ascii_ else "binary"} if kind == "ply" else {}
    data = mesh.export(file_type="stl_ascii" if kind == "stl" and ascii_ else kind, **options)
    return data.encode() if isinstance(data, str) else data


WRITERS = [(writer, kind) for writer in ("trimesh", "meshio", "pymeshlab") for kind in ("off", "obj", "ply", "stl")]


@pytest.mark.parametrize("ascii_", [False, True])
@pytest.mark.parametrize(("writer", "kind"), [*WRITERS, ("trimesh", "glb")])
def test_files_of_independent_writers_are_read(writer, kind, ascii_, tmp_path):
    path = tmp_path / f"torus.{kind}"
    if writer == "trimesh":
        path.write_bytes(written_by_trimesh(kind, ascii_))
    elif writer == "meshio":
        mesh = meshio.Mesh(TORUS.vertices, [("triangle", TORUS.faces)])
        mesh.write(path, **({"binary": not ascii_} if kind in {"stl", "ply"} else {}))
    else:
        meshes = pymeshlab.MeshSet(verbose=False)
        meshes.add_mesh(pymeshlab.Mesh(TORUS.vertices, TORUS.faces))
        meshes.save_current_mesh(str(path), **({"binary": not ascii_} if kind in {"stl", "ply"} else {}))
    mesh = parsed(path)
    np.testing.assert_allclose(mesh.vertices[mesh.faces], TORUS.vertices[TORUS.faces], atol=2e-6)
    assert mesh.notes == ()


def test_polygons_written_by_meshio_are_read(tmp_path):
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0.0]])
    for kind in ("obj", "ply"):
        path = tmp_path / f"mixed.{kind}"
        cells = [("triangle", np.array([[1, 4, 2]])), ("quad", np.array([[0, 1, 2, 3]]))]
        meshio.Mesh(points, cells).write(path)
        mesh = parsed(path)
        assert areas(mesh.vertices, mesh.faces).sum() == pytest.approx(1.5)
        np.testing.assert_array_equal(mesh.faces, [[1, 4, 2], [0, 1, 2], [0, 2, 3]])


def test_texture_coordinates_in_glb_are_read_by_trimesh():
    uv = np.column_stack([np.linspace(0, 1, len(TORUS.vertices)), np.linspace(1, 0.5, len(TORUS.vertices))])
    data = write_mesh(TORUS.vertices, TORUS.faces, "glb", uv=uv)
    mesh = trimesh.load(io.BytesIO(data), file_type="glb", process=False, force="mesh")
    np.testing.assert_allclose(mesh.visual.uv, uv, atol=1e-6)
