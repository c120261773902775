"""The three methods of scaling: exact on Euclidean distances, ordered by stress, independent of the order of points."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.distance import pdist, squareform

from unbend import effective_dimension, embed, geodesic_matrix, representation_errors
from unbend.embedding.least_squares import smacof
from unbend.embedding.stress import stress
from unbend.embedding.weighting import weights_for
from unbend.errors import ParameterError
from unbend.mesh.shapes import cylinder, ellipsoid, s_bend, sheet, sphere, spiral, torus

METHODS = ("classical", "least_squares", "fast")


def cloud(seed: int, count: int = 40, dimensions: int = 3) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(count, dimensions))


def city_block(seed: int, count: int = 40) -> np.ndarray:
    return squareform(pdist(cloud(seed, count, 5), "cityblock"))


@pytest.fixture(scope="module")
def torus_distances() -> np.ndarray:
    surface = torus(columns=36, rows=20)
    return geodesic_matrix(surface, np.arange(0, 720, 6))


@given(st.integers(0, 2**32 - 1), st.integers(1, 5), st.sampled_from(METHODS))
def test_euclidean_distances_are_recovered(seed, dimensions, method):
    distances = squareform(pdist(cloud(seed, 20, dimensions)))
    found = embed(distances, dimensions, method=method)
    # FastMap divides by residual distances, which loses digits where a pivot pair is short.
    tolerance = 1e-9 if method != "fast" else 1e-6
    np.testing.assert_allclose(squareform(pdist(found.points)), distances, atol=tolerance * distances.max())
    assert found.stress < tolerance


@given(st.integers(0, 2**32 - 1), st.integers(1, 4))
def test_least_squares_has_the_lowest_stress(seed, dimensions):
    distances = city_block(seed)
    found = {method: embed(distances, dimensions, method=method).stress for method in METHODS}
    assert found["least_squares"] <= found["classical"] + 1e-12
    assert found["least_squares"] <= found["fast"] + 1e-12


@pytest.mark.parametrize("method", METHODS)
def test_stress_falls_with_the_number_of_dimensions(torus_distances, method):
    found = [embed(torus_distances, m, method=method).stress for m in range(1, 6)]
    assert found[2] < 0.2 * found[0]
    if method == "least_squares":  # the other methods do not minimise stress, which may rise slightly, as in Table 2
        assert all(after <= before * 1.01 for before, after in itertools.pairwise(found))


def test_the_reported_stress_is_that_of_the_returned_points():
    distances = city_block(1)
    for method in METHODS:
        found = embed(distances, 3, method=method)
        straight = squareform(pdist(found.points))
        upper = np.triu_indices(len(distances), 1)
        expected = ((distances - straight)[upper] ** 2).sum() / (distances[upper] ** 2).sum()  # eq. 2
        assert found.stress == pytest.approx(expected)


def test_smacof_agrees_with_a_plain_implementation_of_eq_8_and_9():
    distances, z = city_block(2, 15), cloud(3, 15)
    weights = squareform(np.random.default_rng(4).uniform(0, 2, 105))
    z -= z.mean(axis=0)
    for w in (None, weights):
        w_all = np.ones((15, 15)) if w is None else w
        straight = squareform(pdist(z))
        b = -w_all * distances / np.where(straight > 0, straight, 1)
        np.fill_diagonal(b, 0)
        np.fill_diagonal(b, -b.sum(axis=1))
        v = -w_all.copy()
        np.fill_diagonal(v, 0)
        np.fill_diagonal(v, -v.sum(axis=1))
        expected = np.linalg.pinv(v) @ b @ z
        found, made = smacof(distances, z, w, memory=0, iterations=1)
        assert made == 1
        np.testing.assert_allclose(found, expected, atol=1e-5)  # far from the minimum, smacof uses single precision


def test_every_iteration_lowers_the_stress():
    distances, start = city_block(5), cloud(6)
    found = [stress(smacof(distances, start, iterations=n, decrease=0.0)[0], distances) for n in range(0, 30, 3)]
    assert all(after <= before for before, after in itertools.pairwise(found))


def test_equal_weights_change_nothing_and_weight_zero_ignores_a_pair():
    distances = city_block(7)
    for ones in (np.ones_like(distances), 2.0 * (1.0 - np.eye(len(distances))), np.full(len(distances), 3.0)):
        np.testing.assert_allclose(embed(distances, weights=ones).points, embed(distances).points, atol=1e-9)
    euclidean = squareform(pdist(cloud(8)))
    wrong = euclidean.copy()
    wrong[0, 1] = wrong[1, 0] = 50.0
    weights = np.ones_like(wrong)
    weights[0, 1] = weights[1, 0] = 0.0
    assert embed(wrong, weights=weights).stress < 0.01 * embed(wrong).stress


def test_only_relative_weights_matter_and_too_wide_a_range_is_refused():
    distances = city_block(20)
    weights = squareform(np.random.default_rng(20).uniform(0.5, 2, 780))
    for factor in (1e-60, 1e60):
        np.testing.assert_allclose(
            embed(distances, weights=factor * weights).points, embed(distances, weights=weights).points, atol=1e-6
        )
    weights[:20, 20:] = weights[20:, :20] = 1e-40
    with pytest.raises(ParameterError, match="orders of magnitude"):
        embed(distances, weights=weights)


def test_points_of_large_weight_have_less_stress():
    distances = city_block(14, 60)
    heavy = np.arange(60) < 20
    for method in ("classical", "least_squares"):
        plain, weighted = (
            embed(distances, 2, method=method, weights=weights).points
            for weights in (None, np.where(heavy, 100.0, 1.0))
        )
        among = np.ix_(heavy, heavy)
        fits = [stress(points[heavy], distances[among]) for points in (plain, weighted)]
        assert fits[1] < 0.9 * fits[0], method


def test_integer_weights_in_classical_scaling_equal_repeated_points():
    distances, times = city_block(15, 30), np.random.default_rng(15).integers(1, 4, 30)
    repeated = np.repeat(np.arange(30), times)
    every = embed(distances[np.ix_(repeated, repeated)], method="classical").points
    found = embed(distances, method="classical", weights=times).points
    np.testing.assert_allclose(squareform(pdist(found)), squareform(pdist(every[np.cumsum(times) - 1])), atol=1e-9)


def test_acceleration_reaches_the_minimum_of_smacof_in_less_than_half_the_iterations(torus_distances):
    start = embed(torus_distances, method="classical").points
    least = stress(smacof(torus_distances, start, memory=0, decrease=0.0, iterations=3000)[0], torus_distances)
    counts = []
    for memory in (0, 8):
        for made in range(1, 300):
            found, _ = smacof(torus_distances, start, memory=memory, decrease=0.0, iterations=made)
            if stress(found, torus_distances) <= least * (1 + 1e-4):
                counts.append(made)
                break
    assert counts[1] < 0.5 * counts[0]


def test_the_number_of_threads_does_not_change_the_embedding():
    distances = city_block(16, 1100)
    one, two = (embed(distances, threads=threads) for threads in (1, 3))
    np.testing.assert_array_equal(one.points, two.points)
    assert one.iterations == two.iterations > 0


def test_classical_scaling_of_many_points_has_the_eigenvalues_of_a_dense_solver():
    distances = city_block(17, 500)
    centring = np.eye(500) - 1 / 500
    expected = np.linalg.eigvalsh(-0.5 * centring @ distances**2 @ centring)[::-1][:4]
    found = embed(distances, 4, method="classical")
    np.testing.assert_allclose(found.eigenvalues, expected, rtol=1e-9)
    np.testing.assert_allclose(np.diag(found.points.T @ found.points), expected, rtol=1e-9)


def test_repeated_eigenvalues_are_all_found():
    corners = np.concatenate([np.eye(3), -np.eye(3)])
    points = np.repeat(corners, 100, axis=0)
    distances = squareform(pdist(points))
    found = embed(distances, 3, method="classical")
    np.testing.assert_allclose(found.eigenvalues, 200.0, rtol=1e-9)
    assert found.stress < 1e-18


def test_random_starts_never_raise_the_stress_and_can_lower_it():
    distances = city_block(18, 30)
    plain, tried = embed(distances, 1), embed(distances, 1, starts=20)
    assert tried.stress < plain.stress
    assert tried.stress == embed(distances, 1, starts=20).stress


@given(st.integers(0, 2**32 - 1), st.integers(1, 6))
def test_the_effective_dimension_of_points_is_the_dimension_of_their_space(seed, dimensions):
    distances = squareform(pdist(cloud(seed, 60, dimensions)))
    errors = representation_errors(distances)
    assert (np.diff(errors) <= 0).all()
    assert errors[dimensions - 1] < 1e-6
    assert effective_dimension(distances, error=1e-3) == dimensions
    assert embed(distances, "auto").points.shape == (60, effective_dimension(distances))


def test_the_representation_error_is_eq_6():
    distances = city_block(19, 30)
    centring = np.eye(30) - 1 / 30
    values = np.maximum(np.linalg.eigvalsh(-0.5 * centring @ distances**2 @ centring)[::-1], 0)
    expected = np.sqrt([(values[m:] ** 2).sum() / (values**2).sum() for m in range(1, 31)])
    np.testing.assert_allclose(representation_errors(distances), expected, atol=1e-12)


@pytest.mark.parametrize("make", [sheet, cylinder, s_bend, spiral])
def test_developable_sheets_have_two_effective_dimensions(make):
    surface = make(columns=24, rows=12)
    assert effective_dimension(geodesic_matrix(surface, surface.used_vertices)) == 2


@pytest.mark.parametrize("surface", [sphere(subdivisions=2), torus(columns=30, rows=20), ellipsoid(subdivisions=2)])
def test_closed_surfaces_have_three_or_more_effective_dimensions(surface):
    assert effective_dimension(geodesic_matrix(surface, surface.used_vertices)) >= 3


@given(st.integers(0, 2**32 - 1), st.sampled_from(["classical", "least_squares"]))
def test_the_order_of_points_does_not_change_the_stress(seed, method):
    distances = city_block(seed, 20)
    order = np.random.default_rng(seed).permutation(20)
    found = embed(distances[np.ix_(order, order)], method=method)
    assert found.stress == pytest.approx(embed(distances, method=method).stress, rel=1e-3)


def test_repeated_runs_are_equal():
    distances = city_block(9)
    for method in METHODS:
        np.testing.assert_array_equal(embed(distances, method=method).points, embed(distances, method=method).points)


def test_eigenvalues_are_sorted_and_fastmap_counts_clipped_distances():
    distances = city_block(10)
    assert (np.diff(embed(distances, 5).eigenvalues) <= 0).all()
    assert embed(distances, 3, method="fast").clipped > 0
    assert embed(squareform(pdist(cloud(11))), 3, method="fast").clipped == 0


@pytest.mark.parametrize("count", [1, 2, 3])
@pytest.mark.parametrize("method", METHODS)
def test_fewer_points_than_dimensions_leave_columns_zero(count, method):
    distances = squareform(pdist(cloud(12, count))) if count > 1 else np.zeros((1, 1))
    found = embed(distances, 4, method=method)
    assert found.points.shape == (count, 4)
    assert found.stress < 1e-12


def test_coincident_points_stay_together():
    points = np.repeat(cloud(13, 6), 2, axis=0)
    found = embed(squareform(pdist(points)))
    np.testing.assert_allclose(found.points[::2], found.points[1::2], atol=1e-7)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"distances": np.zeros((2, 3))}, "square"),
        ({"distances": [[0, 1], [2, 0]]}, "symmetric"),
        ({"distances": [[0, np.inf], [np.inf, 0]]}, "component"),
        ({"distances": [[0, -1], [-1, 0]]}, "negative"),
        ({"distances": [[1, 1], [1, 0]]}, "diagonal"),
        ({"distances": [[0, 1], [1, 0]], "dimensions": 0}, "dimensions"),
        ({"distances": [[0, 1], [1, 0]], "dimensions": 1.5}, "dimensions"),
        ({"distances": [[0, 1], [1, 0]], "dimensions": "all"}, "auto"),
        ({"distances": [[0, 1], [1, 0]], "method": "sammon"}, "least_squares"),
        ({"distances": [[0, 1], [1, 0]], "starts": -1}, "starts"),
        ({"distances": [[0, 1], [1, 0]], "starts": 1, "method": "classical"}, "starts"),
        ({"distances": [[0, 1], [1, 0]], "seed": -1}, "seed"),
        ({"distances": [[0, 1], [1, 0]], "dimensions": "auto", "criterion": "m"}, "criterion"),
        ({"distances": [[0, 1], [1, 0]], "dimensions": "auto", "criterion": "stress", "threshold": 0}, "threshold"),
        ({"distances": [[0, 1], [1, 0]], "dimensions": "auto", "threshold": 1}, "error must lie"),
        ({"distances": [[0, 1], [1, 0]], "threads": 0}, "threads"),
        ({"distances": [[0, 1], [1, 0]], "weights": [1.0, 0.0]}, "above zero"),
        ({"distances": [[0, 1], [1, 0]], "weights": [1.0]}, "weights of points"),
        ({"distances": [[0, 1], [1, 0]], "weights": np.zeros((2, 2))}, "connect"),
        ({"distances": [[0, 1], [1, 0]], "weights": np.ones((3, 3))}, "like distances"),
        ({"distances": [[0, 1], [1, 0]], "weights": -np.ones((2, 2))}, "not negative"),
        ({"distances": [[0, 1], [1, 0]], "weights": np.ones((2, 2)), "method": "fast"}, "least_squares only"),
    ],
)
def test_wrong_arguments_are_refused(arguments, message):
    with pytest.raises(ParameterError, match=message):
        embed(**arguments)


@pytest.mark.parametrize("method", METHODS)
def test_auto_dimensions_by_stress_are_the_fewest_below_the_threshold(torus_distances, method):
    for threshold in (0.3, 0.1, 0.05):
        found = embed(torus_distances, "auto", method=method, criterion="stress", threshold=threshold)
        assert found.stress <= threshold
        fewer = found.points.shape[1] - 1
        assert fewer == 0 or embed(torus_distances, fewer, method=method).stress > threshold


def test_auto_dimensions_by_error_equal_the_effective_dimension(torus_distances):
    for threshold in (0.3, 0.05, 0.02):
        found = embed(torus_distances, "auto", threshold=threshold)
        assert found.points.shape[1] == effective_dimension(torus_distances, error=threshold)


def test_an_unreachable_stress_gives_the_maximal_number_of_dimensions():
    assert embed(city_block(11), "auto", method="fast", criterion="stress", threshold=1e-9).points.shape[1] == 12


def test_the_seed_chooses_random_starts():
    distances = city_block(9)  # embedded on a line, where the stress has many minima
    stresses = {embed(distances, 1, starts=1, seed=seed).stress for seed in range(5)}
    assert len(stresses) > 1
    again = embed(distances, 1, starts=1, seed=3)
    np.testing.assert_array_equal(again.points, embed(distances, 1, starts=1, seed=3).points)


@pytest.mark.parametrize(("rule", "power"), [("inverse", 1), ("inverse_squared", 2)])
def test_inverse_weights_are_powers_of_the_distance_and_favour_near_pairs(torus_distances, rule, power):
    weights = weights_for(rule, torus_distances, np.ones(len(torus_distances)))
    ratio = weights * torus_distances**power
    np.testing.assert_allclose(ratio[torus_distances > 0], ratio.max())
    near = (torus_distances > 0) & (torus_distances < 0.3 * torus_distances.max())

    def error_of_near(**how):
        points = embed(torus_distances, 2, **how).points
        return np.abs(squareform(pdist(points)) - torus_distances)[near].mean()

    assert error_of_near(weights=weights) < error_of_near()


def test_coincident_points_have_finite_weights():
    distances = city_block(12)
    distances[1], distances[:, 1] = distances[0], distances[:, 0]
    distances[[0, 1], [1, 0]] = distances[1, 1] = 0
    found = embed(distances, weights=weights_for("inverse_squared", distances, np.ones(len(distances))))
    assert np.isfinite(found.points).all()


def test_area_weights_are_the_areas_and_equal_weights_are_none():
    areas = np.array([1.0, 2.0, 0.0])
    distances = np.array([[0.0, 1, 2], [1, 0, 1], [2, 1, 0]])
    assert weights_for("equal", distances, areas) is None
    assert weights_for("inverse", np.zeros((3, 3)), areas) is None
    weights = weights_for("area", distances, areas)
    np.testing.assert_array_equal(weights[:2], areas[:2])
    assert 0 < weights[2] < 1e-5


@pytest.mark.parametrize("scale", [1e-300, 1e-200, 1e-80, 1e80, 1e160, 1e200, 1e300])
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("dimensions", [2, "auto"])
def test_the_unit_of_length_does_not_change_the_shape_of_the_embedding(scale, method, dimensions):
    matrix = np.array([[0, 3, 4, 5], [3, 0, 5, 4], [4, 5, 0, 3], [5, 4, 3, 0.0]])  # the corners of a rectangle
    found = embed(matrix * scale, dimensions, method=method)
    assert found.points.shape == (4, 2)
    apart = np.linalg.norm(found.points[:, None] / scale - found.points[None] / scale, axis=2)
    np.testing.assert_allclose(apart, matrix, atol=1e-6)
    assert found.stress < 1e-12


@pytest.mark.parametrize("scale", [1e-300, 1e-200, 1e200, 1e300])
def test_the_scale_of_weights_does_not_change_the_embedding(scale):
    rng = np.random.default_rng(0)
    points = rng.normal(size=(8, 3))
    matrix = np.linalg.norm(points[:, None] - points, axis=2)
    pairs, shares = np.ones((8, 8)), np.arange(1.0, 9.0)
    pairs[0, 1] = pairs[1, 0] = 5.0
    of_pairs, scaled = (embed(matrix, 2, weights=pairs * factor) for factor in (1.0, scale))
    np.testing.assert_allclose(scaled.points, of_pairs.points, atol=1e-4)
    assert scaled.stress / scale == pytest.approx(of_pairs.stress, rel=1e-4)
    for method in ("classical", "least_squares"):
        found, other = (embed(matrix, 2, method=method, weights=shares * factor) for factor in (1.0, scale))
        np.testing.assert_allclose(other.points, found.points, atol=1e-4)


def test_eigenvalues_that_overflow_are_infinite():
    matrix = np.array([[0, 3, 4], [3, 0, 5], [4, 5, 0.0]])
    assert np.isinf(embed(matrix * 1e200, 2, method="classical").eigenvalues).all()
    assert np.isfinite(embed(matrix * 1e100, 2, method="classical").eigenvalues).all()
