"""Measures that align signatures are invariant to pose, scale, and the order of samples and arguments."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from unbend import Parameters, compute_signature
from unbend.matching.measures.pairs import HAUSDORFF, RIGID
from unbend.mesh.shapes import cylinder, figure, sheet, sphere, spiral, torus

both = pytest.mark.parametrize("measure", [RIGID, HAUSDORFF], ids=lambda measure: measure.name)
seeds = st.integers(0, 2**32 - 1)


def orthogonal(seed: int, axes: int) -> np.ndarray:
    """Return a random rotation or reflection."""
    return np.linalg.qr(np.random.default_rng(seed).normal(size=(axes, axes)))[0]


@both
@given(seed=seeds, counts=st.tuples(st.integers(4, 60), st.integers(4, 60)), axes=st.tuples(*[st.integers(1, 6)] * 2))
def test_the_distance_is_symmetric_and_positive(measure, cloud, seed, counts, axes):
    a, b = (cloud(seed + place, counts[place], axes[place]) for place in range(2))
    assert measure.distance(a, b) == measure.distance(b, a) > 0


@both
@given(seed=seeds, axes=st.integers(1, 6))
def test_the_order_of_samples_does_not_change_the_distance(measure, cloud, seed, axes):
    a, b = cloud(seed, axes=axes), cloud(seed + 1, 40, axes)
    order = np.random.default_rng(seed).permutation(len(a.points))
    relabelled = replace(a, points=a.points[order], weights=a.weights[order])
    assert measure.distance(a, a) == measure.distance(a, relabelled) == 0.0
    assert measure.distance(relabelled, b) == measure.distance(a, b)


@both
@given(seed=seeds, axes=st.integers(1, 12), scale=st.floats(1e-3, 1e3))
def test_a_moved_mirrored_scaled_and_reordered_copy_has_distance_zero(measure, cloud, seed, axes, scale):
    a = cloud(seed, axes=axes)
    order = np.random.default_rng(seed).permutation(len(a.points))
    points = scale * (a.points @ orthogonal(seed, axes) + np.arange(axes))
    copy = replace(a, points=points[order], weights=a.weights[order])
    assert measure.distance(a, copy) < 1e-7


@both
@pytest.mark.parametrize("axes", [2, 3, 5])
def test_motions_do_not_change_the_distance_to_other_signatures(measure, cloud, axes):
    for seed in range(20):
        a, b = cloud(seed, axes=axes), cloud(seed + 100, axes=axes)
        moved = replace(a, points=3.0 * a.points @ orthogonal(seed, axes) - 1.0)
        assert measure.distance(moved, b) == pytest.approx(measure.distance(a, b), rel=1e-6)


@both
def test_a_copy_in_more_dimensions_has_distance_zero(measure, cloud):
    flat = cloud(1, axes=2)
    for axes in (3, 5):
        turned = np.pad(flat.points, ((0, 0), (0, axes - 2))) @ orthogonal(axes, axes)
        assert measure.distance(flat, replace(flat, points=turned)) < 1e-7


@both
@given(seed=seeds, size=st.floats(1e-6, 0.05))
def test_a_small_change_has_a_small_distance(measure, cloud, seed, size):
    a = cloud(seed)
    noise = size * np.random.default_rng(seed).uniform(-1, 1, a.points.shape)
    centred = a.points - a.weights @ a.points
    radius = np.sqrt(a.weights @ (centred**2).sum(axis=1))
    # Each point moves by at most the largest noise, and scaling both sets to radius 1 at most doubles this distance.
    largest = np.sqrt((noise**2).sum(axis=1)).max() / radius
    assert measure.distance(a, replace(a, points=a.points + noise)) <= 2.5 * largest + 1e-7


@both
@pytest.mark.parametrize("axes", [3, 4, 5])
def test_alignment_finds_swapped_axes_of_nearly_equal_moments(measure, cloud, signature_of, axes):
    for seed in range(10):
        random = np.random.default_rng(seed)
        raw = random.gamma(2.0, size=(60, axes))
        raw = (raw - raw.mean(axis=0)) @ np.linalg.inv(np.linalg.cholesky(np.cov(raw.T)).T)  # all moments equal
        spread = 0.6 ** np.arange(axes)
        spread[-2:] = spread[-2]
        longer, shorter = np.ones(axes), np.ones(axes)
        longer[-1], shorter[-1] = 1.02, 0.98
        a, b = signature_of(raw * spread * longer), signature_of(raw * spread * shorter)
        assert measure.distance(a, b) < 0.2 * measure.distance(a, cloud(seed, axes=axes))


@both
def test_a_point_of_tiny_weight_hardly_changes_the_distance(measure, cloud):
    a, b = cloud(1), cloud(2)
    weights = np.append(a.weights, 1e-15)
    outlier = replace(
        a, points=np.vstack([a.points, [[9.0, -9.0, 9.0]]]), weights=weights, samples=np.arange(len(weights))
    )
    assert measure.distance(a, outlier) < 1e-6
    assert measure.distance(outlier, b) == pytest.approx(measure.distance(a, b), rel=0.1)


@both
def test_the_scaling_of_signatures_does_not_change_the_distance(measure):
    flat, ball = sheet(columns=16, rows=8), sphere(subdivisions=2)
    area, box = (
        [compute_signature(surface, Parameters(samples=60, scaling=scaling)) for surface in (flat, ball)]
        for scaling in ("area", "box")
    )
    assert measure.distance(*box) == pytest.approx(measure.distance(*area), rel=1e-6)
    assert measure.distance(area[0], box[0]) < 1e-7


@both
def test_bent_sheets_are_nearer_to_each_other_than_to_other_shapes(measure):
    members = [sheet(), cylinder(), spiral(), torus(), sphere()]
    flat, *others = map(compute_signature, members)
    distances = [measure.distance(flat, other) for other in others]
    assert max(distances[:2]) < 0.25 * min(distances[2:])


@both
def test_a_figure_in_another_pose_is_nearer_than_another_figure(measure):
    a, b, other = (
        compute_signature(figure(kind, pose, resolution=1500), Parameters(samples=150))
        for kind, pose in (("biped", 0), ("biped", 1), ("spider", 0))
    )
    assert measure.distance(a, b) < 0.5 * measure.distance(a, other)
