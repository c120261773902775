"""Integrals over triangulated surfaces, compared with closed forms."""

from __future__ import annotations

from itertools import combinations_with_replacement
from math import factorial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from unbend.descriptors.quadrature import surface_quadrature
from unbend.mesh.shapes import sphere, torus

TRIANGLE = np.array([[0, 1, 2]], np.int32)


@pytest.mark.parametrize("powers", [(a, b) for a in range(4) for b in range(4 - a)])
def test_cubics_are_exact_on_the_unit_triangle(powers):
    points, weights = surface_quadrature(np.array([[0, 0], [1, 0], [0, 1.0]]), TRIANGLE, np.full(3, 1 / 6))
    a, b = powers
    exact = factorial(a) * factorial(b) / factorial(a + b + 2)
    assert weights @ (points[:, 0] ** a * points[:, 1] ** b) == pytest.approx(exact, rel=1e-12)


@given(st.lists(st.floats(0, 5), min_size=3, max_size=3))
def test_cubics_are_exact_with_a_linear_density(density):
    """The integral of l1^a l2^b l3^c over a triangle of area A is 2 A a! b! c! / (a + b + c + 2)!.

    Here l1, l2 and l3 are the hat functions of the corners. A linear density is a sum of hat functions, so each of its
    terms adds one hat function to the product.
    """
    corners = np.eye(3)  # so that the coordinates of a point are the values of the hat functions
    area = np.sqrt(3) / 2
    points, weights = surface_quadrature(corners, TRIANGLE, np.array(density) * area / 3)
    for hats in combinations_with_replacement(range(3), 3):
        exact = 0.0
        for corner, value in enumerate(density):
            counts = np.bincount([*hats, corner], minlength=3)
            exact += value * np.prod([factorial(int(count)) for count in counts]) * 2 * area / factorial(6)
        assert weights @ points[:, hats].prod(axis=1) == pytest.approx(exact, rel=1e-12, abs=1e-15)


@pytest.mark.parametrize("surface", [sphere(subdivisions=2), torus()], ids=["sphere", "torus"])
def test_vertex_areas_as_weights_give_the_surface_integral(surface):
    points, weights = surface_quadrature(surface.vertices, surface.faces, surface.vertex_areas)
    assert weights.sum() == pytest.approx(surface.area, rel=1e-12)
    corners = surface.vertices[surface.faces]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    middles = (corners + corners[:, [1, 2, 0]]) / 2
    second = np.einsum("f,fci,fcj->ij", areas / 3, middles, middles)  # edge midpoints are exact for squares
    np.testing.assert_allclose((points * weights[:, None]).T @ points, second, atol=1e-10 * surface.area)


def test_an_isolated_vertex_keeps_its_weight_and_a_vertex_without_area_has_none():
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 5, 5], [np.nan, np.inf, 0]])
    places, masses = surface_quadrature(points, TRIANGLE, np.array([1 / 6, 1 / 6, 1 / 6, 2.0, 0.0]))
    assert np.isfinite(places).all()
    assert masses.sum() == pytest.approx(2.5)
    assert masses[-1] == 2.0
    np.testing.assert_array_equal(places[-1], [5, 5, 5])


def test_vertices_on_a_line_keep_their_weights():
    """The computed area of three points on a line is only rounding error, which must not affect the weights."""
    rng = np.random.default_rng(1)
    points, weights = rng.normal(size=(30, 1)) * 1e3, rng.uniform(0.1, 1.0, 30)
    faces = np.array([rng.choice(30, 3, replace=False) for _ in range(40)], np.int32)
    places, masses = surface_quadrature(points, faces, weights)
    assert masses.sum() == pytest.approx(weights.sum())
    for power in (1, 2, 3):
        assert (masses * places[:, 0] ** power).sum() == pytest.approx((weights * points[:, 0] ** power).sum())
