"""`unbend match`, `unbend transfer` and `unbend symmetry`: what they write, and what they refuse."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from tests.support.commands import failed_with_a_sentence, in_process, succeeded
from unbend import match, read_mesh, symmetry, transfer
from unbend.mesh.shapes import ellipsoid
from unbend.mesh.write import write_mesh


@pytest.fixture(scope="module")
def meshes(tmp_path_factory) -> tuple[Path, Path]:
    """An asymmetric body, and the same body turned and larger."""
    folder, body = tmp_path_factory.mktemp("meshes"), ellipsoid((1.0, 0.7, 0.4))
    bumps = 1 + 0.5 * np.exp(-((body.vertices - (0.9, 0.2, 0.1)) ** 2).sum(axis=1) / 0.1)
    bumps *= 1 + 0.3 * np.exp(-((body.vertices - (-0.3, 0.5, 0.2)) ** 2).sum(axis=1) / 0.1)
    vertices = body.vertices * bumps[:, None]
    paths = folder / "body.off", folder / "turned.off"
    for path, places in zip(paths, (vertices, 3 * vertices[:, [1, 2, 0]]), strict=True):
        path.write_bytes(write_mesh(places, body.faces, "off"))
    return paths


def test_a_match_names_the_points_of_the_file(meshes, tmp_path):
    output = tmp_path / "map.npz"
    done = succeeded("match", *meshes, "-o", output, "--samples", 100)
    assert done.stdout == ""
    assert "distances to near points change by" in done.stderr
    a, b = map(read_mesh, meshes)
    with np.load(output) as arrays:
        places = np.einsum("nc,nck->nk", arrays["barycentric"], b.vertices[arrays["corners"]])
        assert np.linalg.norm(places - b.vertices, axis=1).mean() < 0.05
        assert bool(arrays["oriented"])
        found = match(a, b, samples=100)
        assert np.array_equal(arrays["confidence"], found.confidence)


def test_colours_are_carried(meshes, tmp_path):
    output, colours = tmp_path / "map.ply", tmp_path / "colours.ply"
    succeeded("match", *meshes, "-o", output, "--colours", colours, "--samples", 100, run=in_process)
    one, other = (
        np.frombuffer(path.read_bytes()[-13 * 1280 - 16 * 642 : -13 * 1280], np.uint8) for path in (output, colours)
    )
    red = [each.reshape(642, 16)[:, 12].astype(int) for each in (one, other)]
    assert np.abs(red[0] - red[1]).mean() < 8
    assert np.ptp(red[1]) > 200


def test_joined_seams_keep_the_numbers_of_the_file(meshes, tmp_path):
    apart = tmp_path / "apart.stl"
    body = read_mesh(meshes[0])
    apart.write_bytes(
        write_mesh(body.vertices[body.faces.ravel()], np.arange(3 * len(body.faces)).reshape(-1, 3), "obj")
    )
    apart = apart.rename(tmp_path / "apart.obj")
    output = tmp_path / "map.json"
    succeeded("match", meshes[0], apart, "-o", output, "--samples", 100, run=in_process)
    written = json.loads(output.read_text())
    assert len(written["corners"]) == len(body.vertices)
    places = body.vertices[body.faces.ravel()][np.array(written["corners"])]
    carried = np.einsum("nc,nck->nk", written["barycentric"], places)
    assert np.linalg.norm(carried - body.vertices, axis=1).mean() < 0.02


def test_a_field_labels_and_landmarks_reach_every_target(meshes, tmp_path):
    body = read_mesh(meshes[0])
    field, labels, landmarks = tmp_path / "field.npy", tmp_path / "labels.csv", tmp_path / "landmarks.csv"
    np.save(field, body.vertices)
    names = np.where(body.vertices[:, 0] > 0, "front", "back")
    labels.write_text("\n".join(names) + "\n")
    landmarks.write_text("7\n300\n")
    for values, options in ((field, []), (labels, []), (landmarks, ["--landmarks"])):
        output = tmp_path / values.stem
        succeeded("transfer", meshes[0], values, *meshes, "-o", output, "--samples", 100, *options, run=in_process)
        assert sorted(path.name for path in output.iterdir()) == ["body.csv", "turned.csv"]
    with (tmp_path / "field" / "turned.csv").open() as file:
        carried = np.array(list(csv.reader(file)), float)
    assert np.linalg.norm(carried - body.vertices, axis=1).mean() < 0.02
    assert ((tmp_path / "labels" / "turned.csv").read_text().split() == names).mean() > 0.95
    vertices = np.array((tmp_path / "landmarks" / "turned.csv").read_text().split(), int)
    assert np.linalg.norm(body.vertices[vertices] - body.vertices[[7, 300]], axis=1).max() < 0.1


def test_a_piece_is_matched_to_its_whole(meshes, tmp_path):
    body = read_mesh(meshes[0])
    kept = body.faces[(body.vertices[body.faces] @ (0.5, 0.7, 0.3)).mean(axis=1) > -0.1]
    used, corners = np.unique(kept, return_inverse=True)
    path, output, field = tmp_path / "piece.off", tmp_path / "map.json", tmp_path / "field.npy"
    path.write_bytes(write_mesh(body.vertices[used], corners.reshape(-1, 3), "off"))
    succeeded("match", path, meshes[0], "-o", output, run=in_process)
    written = json.loads(output.read_text())
    places = np.einsum("nc,nck->nk", written["barycentric"], body.vertices[np.array(written["corners"])])
    assert np.linalg.norm(places - body.vertices[used], axis=1).mean() < 0.15
    np.save(field, body.vertices)
    succeeded("transfer", meshes[0], field, path, "-o", tmp_path / "out", run=in_process)
    with (tmp_path / "out" / "piece.csv").open() as file:
        assert np.array(list(csv.reader(file)), float) == pytest.approx(places)
    refused = in_process("match", meshes[0], path, "-o", output)
    assert refused.returncode == 1
    assert "the piece first" in refused.stderr
    succeeded("match", meshes[0], path, "-o", output, "--part", "no", "--samples", 60, run=in_process)


def test_a_symmetry_is_written(meshes, tmp_path):
    output = tmp_path / "map.json"
    succeeded("symmetry", meshes[0], "-o", output, "--samples", 100, run=in_process)
    written, surface = json.loads(output.read_text()), read_mesh(meshes[0])
    found = symmetry(surface, samples=100)
    places = np.einsum("nc,nck->nk", written["barycentric"], surface.vertices[np.array(written["corners"])])
    assert places == pytest.approx(transfer(found, surface.vertices))
    assert written["residual"] == found.residual


def test_what_cannot_be_decided_is_said(tmp_path):
    body = ellipsoid((1.0, 0.7, 0.4))
    faces = body.faces.copy()
    faces[::5] = faces[::5, ::-1]
    path = tmp_path / "mixed.off"
    path.write_bytes(write_mesh(body.vertices, faces, "off"))
    done = succeeded("match", path, path, "-o", tmp_path / "map.npz", "--samples", 100, run=in_process)
    assert "orientation of the triangles does not decide" in done.stderr
    assert "different match is nearly as good" in done.stderr
    refused = in_process("symmetry", path, "-o", tmp_path / "map.npz")
    assert refused.returncode == 1
    assert "do not agree on their sides" in refused.stderr


@pytest.mark.parametrize(
    ("values", "options", "words"),
    [
        ("1.5\n2.5\n", [], "one row for each of the 642 vertices"),
        ("1\n2,3\n", [], "rows of equal length"),
        ("", [], "rows of equal length"),
        ("0.5\n", ["--landmarks"], "one vertex, a whole number"),
        ("9999\n", ["--landmarks"], "no vertex 9999"),
    ],
)
def test_values_that_do_not_fit_are_refused(meshes, tmp_path, values, options, words):
    path = tmp_path / "values.csv"
    path.write_text(values)
    done = in_process("transfer", meshes[0], path, meshes[1], "-o", tmp_path / "out", *options)
    failed_with_a_sentence(done, words)


def test_targets_whose_results_would_be_one_file_are_refused(meshes, tmp_path):
    path, field = tmp_path / "body.obj", tmp_path / "field.npy"
    path.write_text("not read")
    field.write_text("not read")
    done = in_process("transfer", meshes[0], field, meshes[0], path, "-o", tmp_path / "out")
    failed_with_a_sentence(done, "would both be body.csv", status=2)
    assert not (tmp_path / "out").exists()


def test_files_that_cannot_be_written_are_refused_first(meshes, tmp_path):
    failed_with_a_sentence(in_process("match", *meshes, "-o", tmp_path / "map.txt"), "format must be")
    failed_with_a_sentence(in_process("match", *meshes, "-o", tmp_path / "map.npz", "--samples", 3), "samples must be")
