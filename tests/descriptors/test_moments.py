"""Moments and pose: plain formulas, and continuity where two second moments are equal."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from unbend.descriptors.moments import moments
from unbend.descriptors.pose import principal_pose
from unbend.mesh.shapes import bent_tube, sphere, torus

SHAPES = {"torus": torus(), "sphere": sphere(subdivisions=3), "tube": bent_tube()}
MIXED = ((0, 0, 0), (0, 1, 1), (0, 1, 2), (0, 2, 2), (1, 1, 1), (1, 1, 2), (1, 2, 2), (2, 2, 2))


def cloud(seed: int, axes: int = 3) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.gamma(2.0, size=(60, axes)) * np.linspace(4, 1, axes), rng.uniform(0.1, 1, 60)


def lopsided(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Points of a shape with two or three equal second moments, and third moments that are not zero by symmetry."""
    points, rng = SHAPES[name].vertices, np.random.default_rng(5)
    weights = 1 + 0.5 * rng.random(len(points))
    share = weights / weights.sum()
    centred = points - share @ points
    values, axes = np.linalg.eigh((centred * share[:, None]).T @ centred)
    level = values.copy()
    level[:2] = values[:2].mean()  # exactly two equal ones
    if name == "sphere":
        level[:] = values.mean()
    return centred @ axes * np.sqrt(level / values) @ axes.T, weights


def test_in_a_frame_of_axes_far_apart_they_are_the_plain_moments():
    rng = np.random.default_rng(0)
    points, weights = rng.gamma(2.0, size=(400, 3)) * [1.0, 0.7, 0.3], rng.uniform(0.1, 1, 400)
    posed = principal_pose(points, weights)
    share = weights / weights.sum()
    second, third = share @ posed**2, np.einsum("n,ni,nj,nk->ijk", share, posed, posed, posed)
    sums = np.abs(np.einsum("ijj->i", third))
    plain = np.concatenate([sums, [abs(third[axes]) for axes in MIXED]]) / np.sqrt(second.sum())
    np.testing.assert_allclose(moments(points, weights), np.concatenate([second, plain]), rtol=1e-4)


@given(st.integers(0, 2**32 - 1), st.booleans(), st.floats(1e-3, 1e3))
def test_turned_mirrored_moved_and_reordered_sets_have_the_same_moments(rotation, seed, mirrored, factor):
    points, weights = cloud(seed)
    order = np.random.default_rng(seed).permutation(len(points))
    moved = factor * points @ rotation(seed).T * ([1, 1, -1] if mirrored else 1) + [1, 2, 3]
    found = moments(moved[order], 7 * weights[order])
    np.testing.assert_allclose(found, factor**2 * moments(points, weights), rtol=1e-6, atol=1e-9 * found.max())


@pytest.mark.parametrize("name", SHAPES)
@given(seed=st.integers(0, 2**32 - 1))
def test_equal_axes_make_no_jump(rotation, name, seed):
    """The moments along fixed axes do jump here."""
    points, weights = lopsided(name)
    before = moments(points, weights)
    assert np.linalg.norm(before[3:]) > 1e-3 * np.linalg.norm(before[:3])
    size = np.abs(points).max()
    noise = 1e-6 * size * np.random.default_rng(seed).normal(size=points.shape)
    for other in (points @ rotation(seed).T, points * [1, -1, 1], points + noise, points * [1 + 1e-6, 1, 1 - 1e-6]):
        assert np.linalg.norm(moments(other, weights) - before) < 1e-4 * np.linalg.norm(before)


def test_relative_signs_tell_sets_apart_that_absolute_values_do_not():
    """A set of points with T_000 and T_011 of equal or opposite signs, and the same second moments either way."""

    def drop(sign: float) -> np.ndarray:
        x = np.array([2.0, -1.0, -1.0, 0.4 * sign, 0.4 * sign, -0.4 * sign, -0.4 * sign, 0, 0]) * 3
        y = np.array([0, 0, 0, 1.0, -1.0, 0.2, -0.2, 0, 0])
        z = np.array([0, 0, 0, 0, 0, 0, 0, 0.3, -0.3])
        return np.column_stack([x, y, z])

    one, two = (moments(drop(sign), np.ones(9)) for sign in (1.0, -1.0))
    np.testing.assert_allclose(one[6:], two[6:], atol=1e-9)
    assert abs(one[3] - two[3]) > 1e-3 * one[0]


@pytest.mark.parametrize("axes", [1, 2, 3, 4, 7])
def test_there_are_fourteen_whatever_the_dimension(axes):
    points, weights = cloud(1, axes)
    found = moments(points, weights)
    assert found.shape == (14,)
    assert np.isfinite(found).all()
    assert (found[: min(axes, 3)] > 0).all()
    np.testing.assert_allclose(found[axes:3], 0, atol=1e-12 * found.max())
    if axes < 3:
        padded = np.hstack([points, np.zeros((len(points), 3 - axes))])
        np.testing.assert_allclose(moments(padded, weights), found, atol=1e-9 * found.max())


def test_points_in_one_place_have_no_moments():
    np.testing.assert_array_equal(moments(np.ones((5, 3)), np.ones(5)), np.zeros(14))


def test_the_sizes_of_surfaces_are_no_matter():
    points, weights = cloud(2)
    with np.errstate(all="raise"):
        for factor in (1e-100, 1e100):
            np.testing.assert_allclose(moments(factor * points, weights) / factor**2, moments(points, weights))


@pytest.mark.parametrize("seed", range(20))
def test_rounding_does_not_choose_the_sides_of_a_symmetric_set(seed):
    half = np.random.default_rng(seed).normal(size=(40, 3)) * [3, 2, 1]
    points = np.vstack([half, -half])
    before = principal_pose(points, np.ones(80))
    for trial in range(5):
        noise = 1e-9 * np.random.default_rng(trial).normal(size=points.shape)
        np.testing.assert_allclose(principal_pose(points + noise, np.ones(80)), before, atol=1e-6)


def test_each_axis_points_to_the_side_of_its_larger_third_moment():
    points, weights = cloud(3)
    for mirrored in (points, points * [-1, 1, 1], points * [1, -1, -1]):
        posed = principal_pose(mirrored, weights)
        assert (weights @ posed**3 > 0).all()
