"""Orientation of forms: known rotations and reflections are undone, and nothing else changes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.distance import pdist

from unbend.errors import ParameterError
from unbend.mesh.shapes import figure
from unbend.signature.orientation import orient_form

POINTS = figure("quadruped", 1).vertices[::7]


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("mirrored", [False, True])
def test_a_rotation_or_reflection_is_undone(rotation, seed, mirrored):
    signs = np.diag([1.0, 1.0, -1.0 if mirrored else 1.0])
    centred = POINTS - POINTS.mean(axis=0)
    turned = orient_form(3.0 * centred @ rotation(seed) @ signs, POINTS + np.array([5.0, -2.0, 1.0]))
    np.testing.assert_allclose(turned, 3.0 * centred, atol=1e-9)  # the result keeps the form's scale and origin


def test_further_coordinates_and_distances_stay(rotation):
    rng = np.random.default_rng(0)
    form = np.hstack([POINTS @ rotation(1) + rng.normal(size=POINTS.shape) / 50, rng.normal(size=(len(POINTS), 2))])
    turned = orient_form(form, POINTS)
    np.testing.assert_array_equal(turned[:, 3:], form[:, 3:])
    np.testing.assert_allclose(pdist(turned), pdist(form))


def test_no_small_turn_of_the_result_lies_better(rotation):
    rng = np.random.default_rng(1)
    weights = rng.uniform(0.1, 1.0, len(POINTS))
    turned = orient_form(POINTS @ rotation(2) + rng.normal(size=POINTS.shape), POINTS, weights)

    def misfit(points):
        apart, onto = (each - weights @ each / weights.sum() for each in (points, POINTS))
        return weights @ ((apart - onto) ** 2).sum(axis=1)

    for axis in np.eye(3):
        for angle in (-0.01, 0.01):
            cross = np.cross(np.eye(3), axis)
            small = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
            assert misfit(turned @ small) > misfit(turned)


def test_rows_that_are_not_finite_are_ignored_and_stay(rotation):
    form = POINTS @ rotation(3)
    form[4] = np.nan
    surface = POINTS.copy()
    surface[9] = np.nan
    turned = orient_form(form, surface)
    assert np.isnan(turned[4]).all()
    known = np.arange(len(POINTS)) != 4
    np.testing.assert_allclose(turned[known], POINTS[known], atol=1e-9)


def test_a_flat_form_lies_on_a_flat_surface(rotation):
    flat = POINTS * [1.0, 1.0, 0.0]
    np.testing.assert_allclose(orient_form(flat @ rotation(4), flat), flat, atol=1e-9)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((POINTS[:, :2], POINTS), "form_points must be"),
        ((POINTS, POINTS[1:]), "surface_points must be"),
        ((POINTS, POINTS, np.ones(3)), "weights must be"),
        ((POINTS, POINTS, -np.ones(len(POINTS))), "none negative"),
        ((POINTS, POINTS, np.full(len(POINTS), np.nan)), "none negative"),
        ((np.full_like(POINTS, np.nan), POINTS), "no point is finite"),
    ],
)
def test_what_does_not_fit_is_refused(arguments, words):
    with pytest.raises(ParameterError, match=words):
        orient_form(*arguments)
