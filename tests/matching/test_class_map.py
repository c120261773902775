"""The class map: it keeps distances, separates classes, and places many shapes by landmarks."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import pdist

from unbend.errors import ParameterError
from unbend.matching import class_map as module
from unbend.matching.class_map import class_map
from unbend.matching.measures import get_vector_measure

MOMENTS = get_vector_measure("moments")


def on_a_line(count: int, seed: int = 0) -> np.ndarray:
    """Return vectors whose L1 distances are those of points on a line."""
    places = np.random.default_rng(seed).uniform(0, 10, count)
    return (places[:, None] * np.array([1.0, 0.5, 0.25])).astype(np.float32)


def clusters(classes: int, members: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    centres = rng.normal(0, 10, (classes, 8))
    labels = np.repeat(np.arange(classes), members)
    return (centres[labels] + rng.normal(0, 0.3, (len(labels), 8))).astype(np.float32), labels


@pytest.mark.parametrize("dimensions", [1, 2, 3])
def test_distances_of_points_on_a_line_are_kept(dimensions):
    vectors = on_a_line(60)
    found = class_map(vectors, MOMENTS, dimensions)
    assert found.points.shape == (60, dimensions)
    np.testing.assert_allclose(pdist(found.points), pdist(vectors, "cityblock"), atol=1e-3)
    assert found.stress < 1e-7


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_map_of_few_shapes_keeps_distances(count):
    vectors = on_a_line(count)
    found = class_map(vectors, MOMENTS)
    np.testing.assert_allclose(pdist(found.points), pdist(vectors, "cityblock"), rtol=1e-4)


def test_a_map_of_no_shapes_is_empty():
    assert class_map(np.empty((0, 3), np.float32), MOMENTS).points.shape == (0, 2)


def test_equal_shapes_have_equal_points():
    assert not class_map(np.ones((5, 3), np.float32), MOMENTS).points.any()


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1), st.sampled_from([1e-5, 1.0, 1e5]))
def test_order_and_unit_do_not_change_the_form_of_the_map(seed, unit):
    vectors, _ = clusters(4, 6, seed % 100)
    order = np.random.default_rng(seed).permutation(len(vectors))
    first, second = class_map(vectors, MOMENTS), class_map(unit * vectors[order], MOMENTS)
    found, expected = pdist(second.points) / unit, pdist(first.points[order])
    np.testing.assert_allclose(found, expected, atol=1e-3 * expected.max())  # least squares stops at 1e-6 of the stress


def test_a_map_by_landmarks_is_near_the_map_of_all_shapes(monkeypatch):
    vectors, labels = clusters(12, 60)
    whole = class_map(vectors, MOMENTS)
    monkeypatch.setattr(module, "MAX_LANDMARKS", 240)
    placed = class_map(vectors, MOMENTS)
    assert not np.array_equal(placed.points, whole.points)
    assert np.corrcoef(pdist(placed.points), pdist(whole.points))[0, 1] > 0.95
    spread = [np.ptp(placed.points[labels == label], axis=0).max() for label in range(12)]
    assert max(spread) < 0.2 * np.ptp(placed.points, axis=0).max()


def test_the_number_of_threads_does_not_change_the_map():
    vectors, _ = clusters(5, 8)
    one, two = (class_map(vectors, MOMENTS, threads=threads) for threads in (1, 2))
    np.testing.assert_array_equal(one.points, two.points)


def test_a_map_of_no_dimensions_is_refused():
    with pytest.raises(ParameterError, match="dimensions"):
        class_map(on_a_line(5), MOMENTS, 0)
