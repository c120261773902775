"""Flattening: isometric if possible, otherwise with correct measures of distortion."""

from __future__ import annotations

import io
import json

import numpy as np
import pytest
import trimesh
from scipy.spatial.distance import pdist

from unbend import Parameters, Surface, flatten, read_mesh
from unbend.errors import ParameterError
from unbend.mesh.shapes import cylinder, s_bend, sheet, sphere, spiral, torus
from unbend.signature.flattening import Flattening, export_flattening

SHEETS = {"sheet": sheet, "cylinder": cylinder, "s": s_bend, "spiral": spiral}


@pytest.mark.parametrize("bending", SHEETS)
def test_developable_surfaces_flatten_isometrically(bending):
    flat, surface = sheet(columns=60, rows=30), SHEETS[bending](columns=60, rows=30)
    found = flatten(surface)
    some = np.random.default_rng(0).choice(len(flat.vertices), 300, replace=False)
    true = pdist(flat.vertices[some])
    assert np.abs(pdist(found.uv[some]) * found.scale - true).max() < 1e-3 * true.max()
    assert found.stress < 1e-6
    assert found.mean_distortion < 1.0005
    assert found.max_distortion < 1.01
    assert found.flipped == 0
    np.testing.assert_allclose(found.stretches, 1.0, atol=0.01)


@pytest.mark.parametrize("surface", [sheet(width=2, height=0.5), spiral(), sphere(subdivisions=3)])
def test_texture_coordinates_start_at_zero_fill_one_side_and_keep_lengths(surface):
    found = flatten(surface, Parameters(samples=100))
    np.testing.assert_allclose(found.uv.min(axis=0), 0, atol=1e-12)
    assert found.uv.max() == pytest.approx(1.0)
    edges = np.linalg.norm(np.diff(found.uv[surface.faces[:, :2]], axis=1)[:, 0], axis=1) * found.scale
    own = np.linalg.norm(np.diff(surface.vertices[surface.faces[:, :2]], axis=1)[:, 0], axis=1)
    assert np.median(edges / own) == pytest.approx(1.0, abs=0.35)


def test_flattened_faces_point_up_for_either_orientation():
    surface = s_bend()
    assert flatten(surface).flipped == 0
    assert flatten(Surface(surface.vertices, surface.faces[:, ::-1])).flipped == 0


def test_stretches_of_a_known_map_are_correct():
    surface = sheet(columns=6, rows=4)
    found = flatten(surface)
    known = Flattening(surface.vertices[:, :2] * [3.0, 0.5], 1.0, np.empty((0, 2)), 0.0, surface)
    from unbend.signature.flattening import _stretches

    np.testing.assert_allclose(_stretches(surface, known.uv / surface.scale), [[3.0, 0.5]] * 48, rtol=1e-12)
    turned = _stretches(surface, known.uv[:, ::-1] / surface.scale)
    np.testing.assert_allclose(turned, [[3.0, -0.5]] * 48, rtol=1e-12)
    half = turned.copy()
    half[: len(half) // 2] = [2.0, 1.0]
    mixed = Flattening(known.uv, 1.0, half, 0.0, surface)
    assert mixed.flipped == pytest.approx(0.5)
    assert mixed.mean_distortion == pytest.approx((3.0 + 2.0) / 2)
    assert mixed.max_distortion == pytest.approx(3.0)
    assert found.scale == pytest.approx(2.0, rel=0.01)


def test_a_closed_surface_is_flattened_in_two_layers_and_a_hemisphere_in_one():
    ball = sphere(subdivisions=4)
    closed = flatten(ball)
    assert 0.3 < closed.flipped <= 0.5
    top = (ball.vertices[ball.faces][:, :, 2] >= -1e-9).all(axis=1)
    half = flatten(Surface(ball.vertices, ball.faces[top]))
    assert half.flipped == 0
    assert 1.02 < half.mean_distortion < 1.3  # a curved surface has no isometric flattening
    assert half.stress < 0.1 * closed.stress
    assert np.isnan(half.uv).any()  # vertices of the other half, which no face uses


def test_triangles_of_zero_area_have_no_stretch():
    flat = sheet(columns=10, rows=6)
    middle = (flat.vertices[0] + flat.vertices[1]) / 2
    surface = Surface(np.vstack([flat.vertices, middle]), np.vstack([flat.faces, [[0, 1, len(flat.vertices)]]]))
    found = flatten(surface)
    assert np.isnan(found.stretches[-1]).all()
    assert np.isfinite(found.stretches[:-1]).all()
    assert found.mean_distortion == pytest.approx(1.0, abs=1e-3)
    assert found.max_distortion < 1.01


@pytest.mark.parametrize("file_type", ["obj", "glb"])
def test_a_flattening_is_exported_as_the_mesh_with_texture_coordinates(file_type):
    surface = s_bend(columns=20, rows=10)
    found = flatten(surface)
    data = export_flattening(found, file_type)
    loaded = trimesh.load(io.BytesIO(data), file_type=file_type, process=False, force="mesh")
    np.testing.assert_allclose(loaded.vertices, surface.vertices, atol=1e-6)
    np.testing.assert_array_equal(loaded.faces, surface.faces)
    np.testing.assert_allclose(loaded.visual.uv, found.uv, atol=1e-6)
    again = read_mesh(data)
    np.testing.assert_array_equal(again.faces, surface.faces)
    np.testing.assert_allclose(again.vertices, surface.vertices, atol=1e-6)


def test_json_and_npz_contain_the_coordinates_and_other_formats_are_refused():
    found = flatten(torus(columns=20, rows=12), Parameters(samples=50))
    np.testing.assert_array_equal(json.loads(export_flattening(found, "json"))["uv"], found.uv)
    with np.load(io.BytesIO(export_flattening(found, "npz"))) as arrays:
        np.testing.assert_array_equal(arrays["uv"], found.uv)
    for file_type in ("ply", "off", "step"):
        with pytest.raises(ParameterError, match="obj, glb, json, npz"):
            export_flattening(found, file_type)


def test_a_real_mesh_with_a_boundary_flattens_with_little_stress(shared_data):
    surface = read_mesh(shared_data / "single" / "camelhead.off")  # a head, open at the neck
    found = flatten(surface)
    assert found.stress < 0.1
    assert np.isfinite(found.uv[surface.used_vertices]).all()
    assert found.flipped <= 0.5


def test_flattenings_are_read_only():
    found = flatten(sheet(columns=6, rows=4))
    for array in (found.uv, found.stretches, found.distortion):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
