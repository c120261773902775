"""Descriptors against integrals, plain formulas and the flips they must not feel."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.distance import pdist, squareform

from unbend import Parameters, compute_signature
from unbend.descriptors.distribution import distance_distribution
from unbend.descriptors.moments import moments
from unbend.descriptors.pose import principal_pose
from unbend.descriptors.spectrum import geodesic_spectrum
from unbend.mesh.shapes import sheet


def cloud(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.gamma(2.0, size=(50, 3)) * [3, 2, 1], rng.uniform(0.1, 1, 50)


def test_moments_of_a_flat_sheet_are_the_integrals():
    signature = compute_signature(sheet(width=2.0, height=1.0, columns=30, rows=15), Parameters(samples=5000))
    area = 2.0
    expected = [2.0**2 / 12 / area, 1.0**2 / 12 / area, 0.0]  # mean of x^2 over a segment of length l is l^2 / 12
    np.testing.assert_allclose(signature.moments[:3], expected, atol=2e-3)
    np.testing.assert_allclose(signature.moments[3:], 0, atol=5e-5)


@given(st.integers(0, 2**32 - 1))
def test_the_pose_is_the_same_from_every_side(rotation, seed):
    points, weights = cloud(seed)
    posed = principal_pose(points, weights)
    turned = principal_pose(points @ rotation(seed).T + [1, 2, 3], 7 * weights)
    np.testing.assert_allclose(np.abs(turned), np.abs(posed), atol=1e-7 * np.abs(posed).max())
    np.testing.assert_allclose(squareform(pdist(posed)), squareform(pdist(points)), atol=1e-9)


def test_the_spectrum_is_that_of_the_weighted_kernels():
    points, weights = cloud(1)
    weights = weights / weights.sum()
    distances = squareform(pdist(points[:, :2]))
    found = geodesic_spectrum(distances, weights)
    # diag(w) f(D) has the eigenvalues of its symmetric form
    plain = np.sort(np.abs(np.linalg.eigvals(weights[:, None] * np.exp(-distances))))[::-1]
    np.testing.assert_allclose(found[:50], np.log(plain), atol=1e-6)
    assert (found[50:60] == np.log(1e-9)).all()
    assert found.shape == (160,)


def test_the_spectrum_knows_no_order():
    points, weights = cloud(2)
    distances = squareform(pdist(points))
    order = np.random.default_rng(0).permutation(50)
    share = weights / weights.sum()
    np.testing.assert_allclose(
        geodesic_spectrum(distances[np.ix_(order, order)], share[order]), geodesic_spectrum(distances, share), atol=1e-8
    )


def test_quantiles_of_points_on_a_line():
    points = np.sort(np.random.default_rng(3).uniform(size=(400, 1)), axis=0)
    found = distance_distribution(squareform(pdist(points)), points, np.ones(400)) * 64
    levels = (np.arange(64) + 0.5) / 64
    expected = 1 - np.sqrt(1 - levels)  # |x - y| of two uniform numbers has distribution 1 - (1 - t)^2
    np.testing.assert_allclose(found[:64], expected, atol=0.03)
    np.testing.assert_allclose(found[64:], found[:64])


def test_a_point_counted_twice_is_a_point_of_double_weight():
    points, weights = cloud(4)
    doubled = np.vstack([points, points[:1]])
    halves = np.append(weights, weights[0] / 2)
    halves[0] /= 2
    np.testing.assert_allclose(
        moments(principal_pose(doubled, halves), halves), moments(principal_pose(points, weights), weights), rtol=1e-9
    )
    assert pytest.approx(weights.sum()) == halves.sum()
