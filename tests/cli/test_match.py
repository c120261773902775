"""`unbend match`, `symmetry` and `transfer`: the files that they write, and what they refuse."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.support.commands import failed_with_a_sentence, in_process, succeeded
from tests.support.server import ply
from unbend import Surface, match, read_mesh, symmetry
from unbend.correspondence.export import place_colours
from unbend.mesh.shapes import ellipsoid

SAMPLES = ("--samples", 200)


def bumpy() -> Surface:
    body = ellipsoid((1.0, 0.75, 0.5))
    away = 1.0 + 0.5 * np.exp(-((body.vertices - (0.9, 0.2, 0.1)) ** 2).sum(axis=1) / 0.1)
    return Surface(body.vertices * away[:, None], body.faces)


@pytest.fixture(scope="module")
def meshes(tmp_path_factory) -> tuple[Path, Path]:
    """Two files of the same body: the second is larger, and its vertices are in another order."""
    folder = tmp_path_factory.mktemp("bodies")
    body = bumpy()
    order = np.random.default_rng(0).permutation(len(body.vertices))
    other = Surface(3.0 * body.vertices[order], np.argsort(order)[body.faces])
    paths = folder / "a.ply", folder / "b.ply"
    for path, surface in zip(paths, (body, other), strict=True):
        path.write_bytes(ply(surface))
    return paths


def test_arrays_are_those_of_the_library(meshes, tmp_path):
    done = succeeded("match", *meshes, "-o", tmp_path / "map.npz", *SAMPLES)
    assert "distances to near points change by" in done.stderr
    a, b = map(read_mesh, meshes)
    found = match(a, b, samples=200)
    with np.load(tmp_path / "map.npz") as arrays:
        assert np.array_equal(arrays["corners"], b.faces[found.faces])
        assert np.array_equal(arrays["barycentric"], found.barycentric)
        assert np.array_equal(arrays["confidence"], found.confidence)
        places = (b.vertices[arrays["corners"]] * arrays["barycentric"][:, :, None]).sum(axis=1)
    assert np.linalg.norm(places - 3.0 * a.vertices, axis=1).mean() / np.sqrt(b.area) < 0.02


def test_colours_are_carried(meshes, tmp_path):
    succeeded(
        "match", *meshes, "-o", tmp_path / "a.ply", "--colours", tmp_path / "b.ply", *SAMPLES, run=in_process
    )  # fmt: skip
    import trimesh

    ours, theirs = (trimesh.load(tmp_path / name, process=False) for name in ("a.ply", "b.ply"))
    a, b = map(read_mesh, meshes)
    assert ours.vertices == pytest.approx(a.vertices)
    assert theirs.visual.vertex_colors[:, :3] / 255 == pytest.approx(place_colours(b), abs=0.01)
    apart = np.abs(ours.visual.vertex_colors[:, :3] / 255 - place_colours(a))  # the same body has the same colours
    assert apart.mean() < 0.02


def test_symmetry_writes_mirror_images(tmp_path):
    path = tmp_path / "ellipsoid.ply"
    path.write_bytes(ply(ellipsoid((1.0, 0.7, 0.4))))
    succeeded("symmetry", path, "-o", tmp_path / "mirror.json", *SAMPLES, run=in_process)
    written = json.loads((tmp_path / "mirror.json").read_text())
    surface = read_mesh(path)
    found = symmetry(surface, samples=200)
    assert np.array_equal(written["corners"], surface.faces[found.faces])
    assert written["oriented"]
    assert written["ambiguous"]  # three planes are mirrors


def test_values_labels_and_landmarks_are_written_for_each_target(meshes, tmp_path):
    specimen, target = meshes
    body, other = map(read_mesh, meshes)
    values = tmp_path / "values.csv"
    values.write_text("\n".join(f"{x:.6f}" for x in body.vertices[:, 0]))
    succeeded("transfer", specimen, values, target, "-o", tmp_path / "out", *SAMPLES, run=in_process)
    carried = np.loadtxt(tmp_path / "out" / "b.csv")
    assert np.abs(carried - other.vertices[:, 0] / 3.0).mean() < 0.03
    values.write_text("\n".join(np.where(body.vertices[:, 0] > 0, "front", "back")))
    succeeded("transfer", specimen, values, target, "-o", tmp_path / "out", *SAMPLES, run=in_process)
    labels = (tmp_path / "out" / "b.csv").read_text().split()
    assert np.mean((np.array(labels) == "front") == (other.vertices[:, 0] > 0)) > 0.95
    values.write_text("5\n77\n")
    succeeded("transfer", specimen, values, target, "-o", tmp_path / "out", "--landmarks", *SAMPLES, run=in_process)
    vertices = [int(line) for line in (tmp_path / "out" / "b.csv").read_text().split()]
    assert np.linalg.norm(other.vertices[vertices] / 3.0 - body.vertices[[5, 77]], axis=1).max() < 0.15


@pytest.mark.parametrize(
    ("content", "options", "words"),
    [
        ("1.0\n2.0\n", [], "one row for each"),
        ("999999\n", ["--landmarks"], "no vertex 999999"),
        ("nose\n", ["--landmarks"], "whole number"),
        ("1,2\n3\n", [], "rows of equal length"),
        ("", [], "rows of equal length"),
    ],
)
def test_values_that_do_not_fit_are_refused(meshes, tmp_path, content, options, words):
    values = tmp_path / "values.csv"
    values.write_text(content)
    refused = in_process("transfer", meshes[0], values, meshes[1], "-o", tmp_path / "out", *options, *SAMPLES)
    failed_with_a_sentence(refused, words)
    assert not (tmp_path / "out").exists()


def test_other_formats_are_refused_before_the_work(meshes, tmp_path):
    failed_with_a_sentence(in_process("match", *meshes, "-o", tmp_path / "map.txt"), "txt")
