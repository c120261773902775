"""Exports of signatures: coordinates beyond the third are stored as colours."""

from __future__ import annotations

import io
import json

import numpy as np
import pytest
import trimesh

from unbend import Parameters, Surface, canonical_form, compute_signature, read_mesh
from unbend.errors import ParameterError
from unbend.mesh.shapes import torus
from unbend.signature.export import coordinate_colours, export_form, export_signature

FORMATS = ["ply", "obj", "off", "glb"]
SURFACE = torus(columns=24, rows=16)


def signature_in(dimensions: int):
    return compute_signature(SURFACE, Parameters(samples=120, dimensions=dimensions))


def colours_in(data: bytes, file_type: str) -> np.ndarray | None:
    """Return the vertex colours of a file, from 0 to 1, or None."""
    if file_type == "off":  # trimesh reads only the coordinates of an off file
        lines = data.decode().splitlines()
        if lines[0] == "OFF":
            return None
        rows = np.array([line.split() for line in lines[2 : 2 + int(lines[1].split()[0])]], float)
        assert (rows[:, 6] == 255).all()
        return rows[:, 3:6] / 255
    loaded = trimesh.load(io.BytesIO(data), file_type=file_type, process=False, force="mesh")
    return loaded.visual.vertex_colors[:, :3] / 255 if loaded.visual.kind == "vertex" else None


@pytest.mark.parametrize("file_type", FORMATS)
@pytest.mark.parametrize("dimensions", [4, 5, 6, 9])
def test_coordinates_beyond_the_third_can_be_restored_from_the_colours(file_type, dimensions):
    signature = signature_in(dimensions)
    data = export_signature(signature, file_type)
    surface, colours = read_mesh(data), colours_in(data, file_type)
    np.testing.assert_allclose(surface.vertices, signature.points[:, :3], atol=1e-6)
    np.testing.assert_array_equal(surface.faces, signature.faces)
    further = signature.points[:, 3:6]
    middle = (further.max(axis=0) + further.min(axis=0)) / 2
    widest = np.ptp(further, axis=0).max()
    shown = further.shape[1]
    np.testing.assert_allclose(
        middle + widest * (colours[:, :shown] - 0.5), further, atol=widest * 0.52 / 255
    )  # obj has four digits
    np.testing.assert_allclose(colours[:, shown:], 0.5, atol=0.51 / 255)


@pytest.mark.parametrize("file_type", FORMATS)
@pytest.mark.parametrize("dimensions", [1, 2, 3])
def test_signatures_of_up_to_three_dimensions_have_no_colours(file_type, dimensions):
    data = export_signature(signature_in(dimensions), file_type)
    assert colours_in(data, file_type) is None


def test_colours_use_one_scale_for_all_coordinates():
    points = np.random.default_rng(0).normal(size=(50, 6)) * [1, 1, 1, 3, 1, 0.1]
    colours = coordinate_colours(points)
    assert np.ptp(colours[:, 0]) == pytest.approx(1.0)
    assert colours.min() >= 0
    assert colours.max() <= 1
    np.testing.assert_allclose(np.ptp(colours, axis=0), np.ptp(points[:, 3:], axis=0) / np.ptp(points[:, 3]))
    np.testing.assert_array_equal(coordinate_colours(np.zeros((4, 5))), np.full((4, 3), 0.5))
    points[7] = np.nan
    np.testing.assert_array_equal(coordinate_colours(points)[7], 0.5)
    assert coordinate_colours(points[:, :3]) is None


@pytest.mark.parametrize("file_type", FORMATS)
@pytest.mark.parametrize("dimensions", [2, 3, 5])
def test_canonical_forms_are_exported_with_the_faces_of_the_surface(file_type, dimensions):
    form = canonical_form(SURFACE, Parameters(samples=60, dimensions=dimensions))
    data = export_form(form, file_type)
    surface = read_mesh(data)
    np.testing.assert_array_equal(surface.faces, SURFACE.faces)
    shown = min(3, dimensions)
    np.testing.assert_allclose(surface.vertices[:, :shown], form.points[:, :shown], atol=1e-6)
    assert (colours_in(data, file_type) is not None) == (dimensions > 3)


@pytest.mark.parametrize("file_type", FORMATS)
def test_vertices_without_a_face_are_exported_as_zero(file_type):
    loose = Surface(np.vstack([SURFACE.vertices, [[9, 9, 9]]]), SURFACE.faces)
    form = canonical_form(loose, Parameters(samples=60, dimensions=4))
    surface = read_mesh(export_form(form, file_type))
    np.testing.assert_array_equal(surface.vertices[-1], 0)


def test_json_and_npz_of_a_form_contain_every_coordinate():
    loose = Surface(np.vstack([SURFACE.vertices, [[9, 9, 9]]]), SURFACE.faces)
    form = canonical_form(loose, Parameters(samples=60, dimensions=4))
    reported = json.loads(export_form(form, "json"))
    np.testing.assert_array_equal(reported["points"][:-1], form.points[:-1])
    assert reported["points"][-1] is None
    assert reported["scale"] == form.signature.scale
    with np.load(io.BytesIO(export_form(form, "npz"))) as arrays:
        np.testing.assert_array_equal(arrays["points"], form.points)
        np.testing.assert_array_equal(arrays["faces"], form.faces)
        np.testing.assert_array_equal(arrays["samples"], form.signature.samples)


def test_an_unknown_format_is_refused():
    form = canonical_form(SURFACE, Parameters(samples=60))
    with pytest.raises(ParameterError, match="ply"):
        export_form(form, "step")
