"""Moments and pose: comparison with plain formulas, and continuity where two second moments are equal."""

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
    """Return points with two or three equal second moments, and with third moments that are not zero."""
    points, rng = SHAPES[name].vertices, np.random.default_rng(5)
    weights = 1 + 0.5 * rng.random(len(points))
    share = weights / weights.sum()
    centred = points - share @ points
    values, axes = np.linalg.eigh((centred * share[:, None]).T @ centred)
    level = values.copy()
    level[:2] = values[:2].mean()  # makes exactly two moments equal
    if name == "sphere":
        level[:] = values.mean()
    return centred @ axes * np.sqrt(level / values) @ axes.T, weights


def test_moments_with_distinct_axes_equal_the_plain_moments():
    rng = np.random.default_rng(0)
    points, weights = rng.gamma(2.0, size=(400, 3)) * [1.0, 0.7, 0.3], rng.uniform(0.1, 1, 400)
    posed = principal_pose(points, weights)
    share = weights / weights.sum()
    second, third = share @ posed**2, np.einsum("n,ni,nj,nk->ijk", share, posed, posed, posed)
    sums = np.abs(np.einsum("ijj->i", third))
    plain = np.concatenate([sums, [abs(third[axes]) for axes in MIXED]]) / np.sqrt(second.sum())
    np.testing.assert_allclose(moments(points, weights), np.concatenate([second, plain]), rtol=1e-4)


@given(st.integers(0, 2**32 - 1), st.booleans(), st.floats(1e-3, 1e3))
def test_moments_do_not_depend_on_rotation_reflection_translation_or_order(rotation, seed, mirrored, factor):
    points, weights = cloud(seed)
    order = np.random.default_rng(seed).permutation(len(points))
    moved = factor * points @ rotation(seed).T * ([1, 1, -1] if mirrored else 1) + [1, 2, 3]
    found = moments(moved[order], 7 * weights[order])
    np.testing.assert_allclose(found, factor**2 * moments(points, weights), rtol=1e-6, atol=1e-9 * found.max())


@pytest.mark.parametrize("name", SHAPES)
@given(seed=st.integers(0, 2**32 - 1))
def test_moments_are_continuous_at_equal_axes(rotation, name, seed):
    """The moments along principal axes are discontinuous here."""
    points, weights = lopsided(name)
    before = moments(points, weights)
    assert np.linalg.norm(before[3:]) > 1e-3 * np.linalg.norm(before[:3])
    size = np.abs(points).max()
    noise = 1e-6 * size * np.random.default_rng(seed).normal(size=points.shape)
    for other in (points @ rotation(seed).T, points * [1, -1, 1], points + noise, points * [1 + 1e-6, 1, 1 - 1e-6]):
        assert np.linalg.norm(moments(other, weights) - before) < 1e-4 * np.linalg.norm(before)


def test_moments_distinguish_relative_signs_of_third_moments():
    """The two sets have T_000 and T_011 of equal or opposite signs, and equal second moments."""

    def drop(sign: float) -> np.ndarray:
        x = np.array([2.0, -1.0, -1.0, 0.4 * sign, 0.4 * sign, -0.4 * sign, -0.4 * sign, 0, 0]) * 3
        y = np.array([0, 0, 0, 1.0, -1.0, 0.2, -0.2, 0, 0])
        z = np.array([0, 0, 0, 0, 0, 0, 0, 0.3, -0.3])
        return np.column_stack([x, y, z])

    one, two = (moments(drop(sign), np.ones(9)) for sign in (1.0, -1.0))
    np.testing.assert_allclose(one[6:], two[6:], atol=1e-9)
    assert abs(one[3] - two[3]) > 1e-3 * one[0]


@pytest.mark.parametrize("axes", [1, 2, 3, 4, 7])
def test_there_are_fourteen_moments_in_any_dimension(axes):
    points, weights = cloud(1, axes)
    found = moments(points, weights)
    assert found.shape == (14,)
    assert np.isfinite(found).all()
    assert (found[: min(axes, 3)] > 0).all()
    np.testing.assert_allclose(found[axes:3], 0, atol=1e-12 * found.max())
    if axes < 3:
        padded = np.hstack([points, np.zeros((len(points), 3 - axes))])
        np.testing.assert_allclose(moments(padded, weights), found, atol=1e-9 * found.max())


def test_moments_of_coincident_points_are_zero():
    np.testing.assert_array_equal(moments(np.ones((5, 3)), np.ones(5)), np.zeros(14))


def test_moments_of_extreme_sizes_do_not_overflow():
    points, weights = cloud(2)
    with np.errstate(all="raise"):
        for factor in (1e-100, 1e100):
            np.testing.assert_allclose(moments(factor * points, weights) / factor**2, moments(points, weights))


@pytest.mark.parametrize("seed", range(20))
def test_the_pose_of_a_symmetric_set_is_stable_under_noise(seed):
    half = np.random.default_rng(seed).normal(size=(40, 3)) * [3, 2, 1]
    points = np.vstack([half, -half])
    before = principal_pose(points, np.ones(80))
    for trial in range(5):
        noise = 1e-9 * np.random.default_rng(trial).normal(size=points.shape)
        np.testing.assert_allclose(principal_pose(points + noise, np.ones(80)), before, atol=1e-6)


def test_each_axis_of_the_pose_has_a_positive_third_moment():
    points, weights = cloud(3)
    for mirrored in (points, points * [-1, 1, 1], points * [1, -1, -1]):
        posed = principal_pose(mirrored, weights)
        assert (weights @ posed**3 > 0).all()
