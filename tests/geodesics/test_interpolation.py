"""Interpolation along the surface: exact at samples, and independent of samples that are near only in space."""

from __future__ import annotations

import numpy as np
import pytest

from unbend import Surface, farthest_point_sampling, geodesic_voronoi
from unbend.geodesics.interpolation import interpolate
from unbend.geodesics.stencils import stencils_of
from unbend.mesh.shapes import sheet, spiral, torus


def carried(surface: Surface, samples: np.ndarray, values: np.ndarray, radii: float = 2.0) -> np.ndarray:
    radius = geodesic_voronoi(surface, samples).distances.max()
    return interpolate(stencils_of(surface), samples.astype(np.int32), values, radii * radius, "spherical")


def test_interpolation_is_exact_at_samples_and_for_constants():
    surface = torus(columns=50, rows=30)
    samples = farthest_point_sampling(surface, 60)
    values = np.random.default_rng(0).normal(size=(60, 3))
    np.testing.assert_array_equal(carried(surface, samples, values)[samples], values)
    np.testing.assert_allclose(carried(surface, samples, np.full((60, 2), 7.0)), 7.0, rtol=1e-12)


def test_interpolated_values_stay_in_range_and_follow_a_smooth_function():
    surface = sheet(columns=80, rows=40)
    samples = farthest_point_sampling(surface, 300)
    values = np.sin(2 * surface.vertices[samples, :1])
    found = carried(surface, samples, values)
    assert values.min() <= found.min() <= found.max() <= values.max()
    assert np.abs(found - np.sin(2 * surface.vertices[:, :1])).max() < 0.15


def test_the_layers_of_a_spiral_do_not_affect_each_other():
    surface, flat = spiral(columns=80, rows=20), sheet(columns=80, rows=20)
    samples = farthest_point_sampling(flat, 150)
    values = flat.vertices[samples, :1]
    np.testing.assert_allclose(carried(surface, samples, values), carried(flat, samples, values), atol=0.03)


@pytest.mark.parametrize("update", ["spherical", "planar"])
def test_vertices_beyond_the_radius_are_zero(update):
    surface = sheet(columns=40, rows=4)
    found = interpolate(stencils_of(surface), np.array([0], np.int32), np.ones((1, 1)), 0.5, update)[:, 0]
    far = np.linalg.norm(surface.vertices, axis=1)
    assert (found[far > 0.51] == 0).all()
    np.testing.assert_allclose(found[far < 0.45], 1.0)
