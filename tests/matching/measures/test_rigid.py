"""Iterative closest points, compared with known motions and with a search over all angles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from unbend.matching.measures.icp import refine
from unbend.matching.measures.pairs import RIGID


@given(st.integers(0, 2**32 - 1), st.booleans())
def test_a_known_motion_is_recovered_from_a_near_start(seed, mirrored):
    random = np.random.default_rng(seed)
    points, weights = random.normal(size=(200, 3)), random.uniform(0.1, 1.0, 200)
    points -= points.mean(axis=0)
    turn = Rotation.random(rng=random).as_matrix() * (-1.0 if mirrored else 1.0)
    shift = random.uniform(-0.05, 0.05, 3)
    near = Rotation.from_rotvec(random.uniform(-0.05, 0.05, 3)).as_matrix() @ turn
    motions = np.column_stack([near, np.zeros(3)])[None]
    order, shares = random.permutation(200), weights / weights.sum()
    moved, everything = (points @ turn.T + shift)[order], np.arange(200, dtype=np.int32)
    costs = refine(motions, 100, points, everything, shares, moved, everything, shares[order])
    assert costs[0] < 1e-24
    np.testing.assert_allclose(motions[0], np.column_stack([turn, shift]), atol=1e-9)


def test_each_step_lowers_the_cost(cloud):
    a, b = cloud(1), cloud(2)
    sides = [
        part
        for form in (a, b)
        for part in (form.points - form.weights @ form.points, np.arange(50, dtype=np.int32), form.weights)
    ]
    costs = [refine(np.eye(3, 4)[None].copy(), steps, *sides)[0] for steps in range(1, 30)]
    assert (np.diff(costs) <= 0).all()
    assert costs[-1] < 0.9 * costs[0]


def test_the_rigid_distance_of_two_rectangles_is_the_known_chord(signature_of):
    signs = np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])
    a, b = (signature_of(signs * [np.cos(angle), np.sin(angle)]) for angle in (0.5, 0.6))
    # The corners are on the unit circle, and corresponding corners differ by an angle of 0.1.
    assert RIGID.distance(a, b) == pytest.approx(2 * np.sin(0.05), rel=1e-9)


def test_the_alignment_in_the_plane_is_near_the_best_pose(cloud):
    for seed in range(10):
        a, b = cloud(seed, 30, 2), cloud(seed + 50, 35, 2)
        assert RIGID.distance(a, b) <= 1.15 * nearest_in_the_plane(a, b)


def test_a_noisy_subset_is_aligned_nearly_optimally(cloud):
    for seed in range(10):
        random = np.random.default_rng(seed)
        a, some = cloud(seed, 60, 2), random.choice(60, 50, replace=False)
        turn = np.linalg.qr(random.normal(size=(2, 2)))[0]
        points = (a.points[some] + 0.05 * random.normal(size=(50, 2))) @ turn
        b = replace(a, points=points, weights=a.weights[some] / a.weights[some].sum())
        assert RIGID.distance(a, b) <= 1.01 * nearest_in_the_plane(a, b)


def nearest_in_the_plane(a, b) -> float:
    """Return the least distance that Nelder-Mead finds from the five best turns by whole degrees, mirrored or not."""
    x, y = (at_radius_one(form) for form in (a, b))

    def distance(motion: np.ndarray, mirror: float) -> float:
        cos, sin = np.cos(motion[0]), np.sin(motion[0])
        squares = cdist(x @ np.array([[cos, sin], [-sin, cos]]) * [1.0, mirror] + motion[1:], y, "sqeuclidean")
        return float(np.sqrt((a.weights @ squares.min(axis=1) + b.weights @ squares.min(axis=0)) / 2))

    starts = [(np.array([angle, 0.0, 0.0]), mirror) for angle in np.radians(np.arange(360)) for mirror in (1.0, -1.0)]
    best = sorted(starts, key=lambda start: distance(*start))[:5]
    return min(minimize(distance, start, (mirror,), "Nelder-Mead").fun for start, mirror in best)


def at_radius_one(form) -> np.ndarray:
    centred = form.points - form.weights @ form.points
    return centred / np.sqrt(form.weights @ (centred**2).sum(axis=1))
