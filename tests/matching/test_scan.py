"""Exact search: distances and the nearest rows, compared with NumPy in double precision."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from unbend.errors import ParameterError
from unbend.matching import scan as module
from unbend.matching.scan import scan
from unbend.matching.selection import nearest_of_each_class, smallest

numbers = st.floats(-1e6, 1e6, width=32)
ROUNDING = 2e-5  # relative error of a sum of up to 700 numbers in single precision, in any order


@st.composite
def searches(draw):
    """Draw a query and a gallery with any number of rows, and widths that fill vector registers or not."""
    count, width = draw(st.integers(0, 40)), draw(st.integers(1, 700))
    random = np.random.default_rng(draw(st.integers(0, 2**32)))
    scale = 10.0 ** draw(st.integers(-6, 6))
    query, gallery = random.normal(scale=scale, size=width), random.normal(scale=scale, size=(count, width))
    return query.astype(np.float32), gallery.astype(np.float32)


def by_numpy(query, gallery):
    return np.abs(gallery.astype(np.float64) - query.astype(np.float64)).sum(axis=1)


@given(searches(), st.integers(1, 3))
def test_distances_equal_those_of_numpy(search, threads):
    query, gallery = search
    found = scan(query, gallery, threads)
    assert found.dtype == np.float64
    np.testing.assert_allclose(found, by_numpy(query, gallery), rtol=ROUNDING)


@given(arrays.arrays(np.float32, st.tuples(st.integers(1, 8), st.integers(1, 70)), elements=numbers))
def test_distances_are_exactly_symmetric_and_zero_between_equal_vectors(vectors):
    matrix = np.stack([scan(vector, vectors) for vector in vectors])
    assert np.array_equal(matrix, matrix.T)
    assert not np.diagonal(matrix).any()
    assert np.array_equal(scan(vectors[0], np.repeat(vectors[:1], 5, axis=0)), np.zeros(5))


@given(searches(), st.integers(0, 15))
def test_a_distance_does_not_depend_on_other_rows_or_on_position(search, shift):
    query, gallery = search
    together = scan(query, gallery)
    memory = np.empty(gallery.size + shift, np.float32)
    moved = memory[shift:].reshape(gallery.shape)
    moved[:] = gallery
    assert np.array_equal(scan(query, moved), together)
    assert np.array_equal(scan(query, moved[::-1])[::-1], together)
    assert np.array_equal(scan(query, np.asfortranarray(gallery)), together)
    assert [scan(query, row[None])[0] for row in gallery] == together.tolist()


def test_the_number_of_threads_does_not_change_distances_in_a_large_gallery():
    random = np.random.default_rng(3)
    gallery = random.normal(size=(30_001, 150)).astype(np.float32)
    assert gallery.size > module._SINGLE_THREAD_MAX  # so that several threads are used
    query = gallery[20_000]
    alone = scan(query, gallery, threads=1)
    for threads in (2, 3, None):
        assert np.array_equal(scan(query, gallery, threads), alone)
    np.testing.assert_allclose(alone, by_numpy(query, gallery), rtol=ROUNDING)
    assert np.flatnonzero(alone == 0).tolist() == [20_000]
    assert scan(query, gallery[777:778])[0] == alone[777]


@pytest.mark.parametrize("width", [1, 7, 160])
def test_rows_with_infinite_values_have_infinite_distance(width):
    gallery = np.zeros((4, width), np.float32)
    gallery[1], gallery[2, -1], gallery[3, 0] = np.inf, np.inf, -np.inf
    found = scan(np.ones(width, np.float32), gallery)
    assert np.array_equal(np.isinf(found), [False, True, True, True])


@pytest.mark.parametrize("value", [np.inf, -np.inf, np.nan])
def test_a_query_that_is_not_finite_is_refused(value):
    with pytest.raises(ParameterError, match="not finite"):
        scan(np.array([0, value], np.float32), np.zeros((1, 2), np.float32))


@pytest.mark.parametrize(("query", "gallery"), [((3,), (5, 4)), ((3, 1), (5, 3)), ((3,), (3,)), ((3,), (0, 0))])
def test_vectors_of_different_lengths_are_refused(query, gallery):
    with pytest.raises(ParameterError, match="shape"):
        scan(np.zeros(query, np.float32), np.zeros(gallery, np.float32))


def test_zero_threads_are_refused():
    query, gallery = np.zeros(2, np.float32), np.zeros((1, 2), np.float32)
    with pytest.raises(ParameterError, match="threads"):
        scan(query, gallery, threads=0)


ranked = st.lists(st.one_of(st.integers(0, 5).map(float), st.floats(0, 1e9), st.just(np.inf)), max_size=60)


@given(ranked, st.one_of(st.none(), st.integers(0, 70)))
def test_the_smallest_are_sorted_with_ties_in_order_of_index(distances, count):
    expected = sorted(place for place, distance in enumerate(distances) if distance < np.inf)
    expected.sort(key=lambda place: distances[place])
    assert smallest(np.array(distances), count).tolist() == expected[:count]


@given(st.permutations(range(200)), st.integers(1, 199))
def test_the_smallest_of_any_permutation_are_found(order, count):
    distances = np.array(order) // 3 * 0.5  # groups of three equal values
    assert np.array_equal(smallest(distances, count), np.argsort(distances, kind="stable")[:count])


def test_nan_is_never_among_the_smallest():
    distances = np.array([np.nan, 3.0, np.nan, 1.0, np.inf])
    for count in (None, 2, 3, 4, 5):
        assert smallest(distances, count).tolist() == [3, 1]
    assert smallest(distances, 1).tolist() == [3]


@given(st.lists(st.tuples(st.floats(0, 9), st.integers(-1, 6)), max_size=50))
def test_the_distance_of_a_class_is_that_of_its_nearest_member(rows):
    distances, codes = np.array([row[0] for row in rows]), np.array([row[1] for row in rows], np.int32)
    expected = [min((row[0] for row in rows if row[1] == code), default=np.inf) for code in range(8)]
    assert nearest_of_each_class(distances, codes, 8).tolist() == expected
