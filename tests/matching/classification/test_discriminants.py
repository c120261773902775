"""Linear discriminants, compared with a plain computation by covariance matrices."""

from __future__ import annotations

import gc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from unbend.errors import ParameterError
from unbend.matching.gallery import Gallery, cached_per_gallery

seeds = st.integers(0, 2**32 - 1)


def plain_distances(gallery, query, left_out=()):
    """Return Mahalanobis distances for the covariance shrunk as by Chen et al. 2010, eq. 23."""
    rows = np.setdiff1d(np.flatnonzero(gallery.codes >= 0), left_out)
    vectors, codes = gallery.vectors[rows].astype(float), gallery.codes[rows]
    means = {code: vectors[codes == code].mean(axis=0) for code in np.unique(codes)}
    residuals = vectors - [means[code] for code in codes]
    freedom, size = len(rows) - len(means), vectors.shape[1]
    covariance = residuals.T @ residuals / freedom
    trace, squared = np.trace(covariance), np.trace(covariance @ covariance)
    share = ((1 - 2 / size) * squared + trace**2) / ((freedom + 1 - 2 / size) * (squared - trace**2 / size))
    share = min(share, 1.0)
    inverse = np.linalg.inv((1 - share) * covariance + share * trace / size * np.eye(size))
    return {gallery.labels[code]: np.sqrt((query - mean) @ inverse @ (query - mean)) for code, mean in means.items()}


@given(seeds, st.integers(2, 6), st.integers(2, 7), st.integers(2, 9), st.integers(0, 3))
def test_distances_equal_those_of_the_shrunk_covariance(ask, clouds, seed, classes, members, dimension, unlabelled):
    gallery = clouds(seed, classes, members, dimension, unlabelled)
    query = np.random.default_rng(seed).normal(size=dimension).astype(np.float32)
    answer = ask(gallery, query, "discriminants")
    assert {match.label: match.distance for match in answer.matches} == pytest.approx(
        plain_distances(gallery, query), rel=1e-6
    )


@given(seeds, st.integers(1, 5))
def test_a_stored_query_is_excluded_from_the_model(ask, clouds, seed, count):
    gallery = clouds(seed, classes=3, members=4, dimension=6)
    gone = np.random.default_rng(seed).permutation(len(gallery))[:count]
    query = gallery.vectors[gone[0]]
    answer = ask(gallery, query, "discriminants", gone)
    expected = plain_distances(gallery, query, gone)
    assert {match.label: match.distance for match in answer.matches} == pytest.approx(expected, rel=1e-6)


def test_classes_of_equal_members_give_euclidean_distances(ask):
    gallery = Gallery.of(np.array([[0, 0], [0, 0], [3, 4], [3, 4]], np.float32), ["a", "a", "b", "b"])
    answer = ask(gallery, [3.0, 0.0], "discriminants")
    assert [(match.label, match.distance) for match in answer.matches] == [("a", 3.0), ("b", 4.0)]


def test_leaving_out_the_only_different_member_gives_euclidean_distances(ask):
    points = [[0.1, 0.2], [0.1, 0.2], [0.4, 7.3], [3, 4], [3, 4]]
    gallery = Gallery.of(np.array(points, np.float32), ["a", "a", "a", "b", "b"])
    answer = ask(gallery, [3.0, 0.0], "discriminants", [2])
    expected = [("b", pytest.approx(4.0)), ("a", pytest.approx(np.hypot(2.9, 0.2)))]
    assert sorted((match.label, match.distance) for match in answer.matches) == sorted(expected)


@pytest.mark.parametrize(
    ("labels", "left_out", "there"),
    [
        (["a", "a", "a"], [], "1 classes and 3 labelled"),
        (["a", "b", None], [], "2 classes and 2 labelled"),
        (["a", "a", "b", "b"], [0], "2 classes and 3 labelled"),
        ([None, None], [], "0 classes and 0 labelled"),
    ],
)
def test_too_few_labelled_shapes_are_an_error_with_their_counts(ask, labels, left_out, there):
    gallery = Gallery.of(np.arange(2 * len(labels), dtype=np.float32).reshape(-1, 2), labels)
    with pytest.raises(ParameterError, match=f"at least 2 classes and 2 labelled shapes of each.*{there}"):
        ask(gallery, [0.0, 0.0], "discriminants", left_out)


@pytest.mark.parametrize("classifier", ["mean", "discriminants"])
def test_a_value_that_is_not_finite_is_an_error(ask, clouds, classifier):
    gallery = clouds(0)
    gallery.vectors[3, 1] = np.nan
    with pytest.raises(ParameterError, match=r"row 3 .*not finite"):
        ask(gallery, np.zeros(4), classifier)


def test_values_are_cached_per_gallery_and_evicted_with_it(clouds):
    learned = []

    @cached_per_gallery
    def learn(gallery):
        learned.append(len(gallery))
        return object()

    one, other = clouds(0), clouds(1, members=2)
    assert learn(one) is learn(one)
    assert learn(one) is not learn(other)
    assert learned == [18, 6]
    del one
    gc.collect()
    for seed in range(50):  # a new gallery at the address of the old one is not confused with it
        learn(clouds(seed, members=3))
    assert learned == [18, 6] + [9] * 50
