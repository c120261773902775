"""The Hausdorff distance, compared with SciPy and with closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.distance import cdist, directed_hausdorff

from unbend.matching.measures.alignment import align
from unbend.matching.measures.icp import residuals
from unbend.matching.measures.pairs import HAUSDORFF, MAX_HAUSDORFF, RIGID


@given(st.integers(0, 2**32 - 1), st.integers(3, 6))
def test_distances_between_aligned_sets_equal_scipys(seed, axes):
    random = np.random.default_rng(seed)
    a, b = random.normal(size=(40, axes)), random.normal(size=(60, axes))
    there, back = residuals(np.eye(axes, axes + 1), a, b)
    assert there.max() == pytest.approx(directed_hausdorff(a, b)[0], rel=1e-6)
    assert back.max() == pytest.approx(directed_hausdorff(b, a)[0], rel=1e-6)
    np.testing.assert_allclose(there, cdist(a, b).min(axis=1), rtol=1e-5)
    np.testing.assert_allclose(back, cdist(a, b).min(axis=0), rtol=1e-5)


def test_the_hausdorff_distance_of_two_rectangles_is_the_known_chord(signature_of):
    signs = np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])
    a, b = (signature_of(signs * [np.cos(angle), np.sin(angle)]) for angle in (0.5, 0.6))
    # The corners are on the unit circle, and corresponding corners differ by an angle of 0.1.
    assert HAUSDORFF.distance(a, b) == pytest.approx(2 * np.sin(0.05), rel=1e-9)


@given(st.integers(0, 2**32 - 1))
def test_the_hausdorff_distance_is_the_larger_mean_and_below_the_maximal_one(cloud, seed):
    a, b = cloud(seed), cloud(seed + 1)
    poses = [
        [(float(np.average(d, weights=w)), float(d.max())) for d, w in zip(pose.distances, pose.weights, strict=True)]
        for pose in align(a, b)
    ]
    assert HAUSDORFF.distance(a, b) == pytest.approx(min(max(mean for mean, _ in pose) for pose in poses), rel=1e-12)
    assert MAX_HAUSDORFF.distance(a, b) == min(max(largest for _, largest in pose) for pose in poses)
    assert HAUSDORFF.distance(a, b) <= MAX_HAUSDORFF.distance(a, b)
    # A mean is at most the root mean square. The mean square in one direction is at most twice the mean of both
    # directions.
    assert HAUSDORFF.distance(a, b) <= np.sqrt(2) * RIGID.distance(a, b) * (1 + 1e-12)


def test_an_outlier_dominates_the_maximal_but_not_the_mean_hausdorff_distance(signature_of):
    rng = np.random.default_rng(0)
    points = rng.normal(size=(200, 3)) * [3.0, 2.0, 1.0]
    moved = points.copy()
    moved[0] = [0.0, 0.0, 9.0]
    a, b = signature_of(points), signature_of(moved)
    assert MAX_HAUSDORFF.distance(a, a) == 0
    assert MAX_HAUSDORFF.distance(a, b) > 20 * HAUSDORFF.distance(a, b)
