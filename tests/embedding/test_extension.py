"""Out-of-sample extension, compared with known results."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.distance import cdist, pdist, squareform

from unbend import embed
from unbend.embedding.extension import extend


def cloud(count: int, dimensions: int, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(count, dimensions)) * np.linspace(1.0, 0.4, dimensions)


def squares(points: np.ndarray, landmarks: int) -> np.ndarray:
    return (cdist(points[:landmarks], points) ** 2).astype(np.float32)


@pytest.mark.parametrize("method", ["classical", "least_squares", "fast"])
@pytest.mark.parametrize("dimensions", [1, 2, 3, 8, 12])
def test_euclidean_points_are_recovered(method, dimensions):
    points = cloud(400, dimensions)
    embedded = embed(squareform(pdist(points[:100])), dimensions, method=method).points
    placed = extend(embedded, np.arange(100), squares(points, 60), refine=method == "least_squares")
    assert np.abs(pdist(placed) - pdist(points)).max() < 2e-3 * pdist(points).max()
    np.testing.assert_allclose(placed[:100], embedded, atol=2e-3 * pdist(points).max())


def sphere_distances(count: int) -> np.ndarray:
    points = np.random.default_rng(3).normal(size=(count, 3))
    points /= np.linalg.norm(points, axis=1)[:, None]
    return np.arccos(np.clip(points @ points.T, -1, 1)) * (1 - np.eye(count))


def test_the_extension_of_classical_scaling_equals_landmark_scaling():
    distances = sphere_distances(300)
    inner = distances[:80, :80]
    points = embed(inner, 3, method="classical").points
    placed = extend(points, np.arange(80), (distances[:80] ** 2).astype(np.float32), refine=False)
    means = (inner**2).mean(axis=1)
    known = -0.5 * (distances[:80] ** 2 - means[:, None]).T @ np.linalg.pinv(points).T  # de Silva & Tenenbaum
    assert np.abs(placed - known).max() < 5e-3


def test_refined_points_have_the_least_stress_with_the_landmarks():
    distances = sphere_distances(200)
    points = embed(distances[:80, :80], 3).points
    squared = (distances[:80] ** 2).astype(np.float32)
    rough = extend(points, np.arange(80), squared, refine=False)
    placed = extend(points, np.arange(80), squared, refine=True)

    def loss(place: np.ndarray, vertex: int) -> float:
        return float(((distances[:80, vertex] - np.linalg.norm(points - place, axis=1)) ** 2).sum())

    before, after, least = (
        np.array(values)
        for values in zip(
            *((loss(rough[v], v), loss(placed[v], v), minimize(loss, placed[v], v).fun) for v in range(80, 200)),
            strict=True,
        )
    )
    assert (after <= before).all()
    assert (after - least).max() < 0.02 * (before - least).max()
    assert after.sum() < least.sum() * 1.001


def test_points_that_no_landmark_reaches_are_nan():
    points = cloud(50, 3)
    squared = squares(points, 20)
    squared[:, 49] = np.inf
    placed = extend(points[:30], np.arange(30), squared, refine=True)
    assert np.isnan(placed[49]).all()
    assert np.isfinite(placed[:49]).all()


@pytest.mark.parametrize("refine", [False, True])
def test_coincident_and_degenerate_points_are_placed_correctly(refine):
    points = np.zeros((30, 3))
    points[:, 0] = np.repeat(np.arange(15.0), 2)
    placed = extend(points, np.arange(30), squares(points, 30), refine=refine)
    assert np.abs(placed - points).max() < 1e-3
    still = np.zeros((5, 3))
    np.testing.assert_array_equal(extend(still, np.arange(5), np.zeros((5, 5), np.float32), refine=refine), still)


def test_the_number_of_threads_does_not_change_the_extension():
    points = cloud(500, 3)
    squared = squares(points, 40)
    first = extend(points[:100], np.arange(100), squared, refine=True, threads=1)
    np.testing.assert_array_equal(extend(points[:100], np.arange(100), squared, refine=True, threads=5), first)
