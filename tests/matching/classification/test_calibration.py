"""Calibration: confidences, and the decision whether a query is known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from unbend.matching.classification import CLASSIFIERS
from unbend.matching.classification.calibration import CALIBRATIONS, calibration_of, confidences
from unbend.matching.gallery import Gallery
from unbend.matching.measures import VECTOR_MEASURES

SLACK = calibration_of("moments").slack
seeds = st.integers(0, 2**32 - 1)
dissimilarity_lists = st.lists(st.floats(0, 1e6), min_size=1, max_size=40).map(np.array)
exponents = st.floats(0.5, 50)


@given(dissimilarity_lists, exponents)
def test_confidences_sum_to_one_and_decrease_with_the_distance(dissimilarities, exponent):
    found = confidences(dissimilarities, exponent)
    assert found.sum() == pytest.approx(1.0)
    assert ((found >= 0) & (found <= 1)).all()
    order = np.argsort(dissimilarities, kind="stable")
    assert (np.diff(found[order]) <= 0).all()


@given(st.lists(st.floats(1e-3, 1e3), min_size=2, max_size=9).map(np.array), exponents, st.floats(1e-3, 1e3))
def test_a_change_of_unit_does_not_change_confidences(dissimilarities, exponent, unit):
    assert confidences(unit * dissimilarities, exponent) == pytest.approx(
        confidences(dissimilarities, exponent), abs=1e-9
    )


def test_doubling_the_distance_divides_the_confidence_by_two_to_the_exponent():
    near, far = confidences(np.array([1.5, 3.0]), 5.0)
    assert near / far == pytest.approx(32.0)


def test_every_measure_and_classifier_has_its_own_constants():
    for measure in VECTOR_MEASURES:
        assert set(CALIBRATIONS[measure].exponents) == set(CLASSIFIERS), "run benchmarks/retrieval/classification.py"
        assert calibration_of(measure) is CALIBRATIONS[measure]
        assert CALIBRATIONS[measure].slack > 0
        assert min(CALIBRATIONS[measure].exponents.values()) > 0
    assert calibration_of("another") is CALIBRATIONS["spectrum"]


# --- known or unknown


def on_a_line(a, b=(1000.0,)):
    return Gallery.of(np.array([[place] for place in (*a, *b)], np.float32), ["a"] * len(a) + ["b"] * len(b))


def test_a_query_is_known_up_to_a_multiple_of_the_mean_nearest_neighbour_distance(ask):
    gallery = on_a_line([0.0, 1.0, 3.0])  # nearest neighbour distances of 1, 1 and 2
    edge = 3.0 + SLACK * 4 / 3
    assert ask(gallery, edge - 1e-3).known is True
    assert ask(gallery, edge + 1e-3).known is False
    assert ask(gallery, 2.0).known is True


def test_known_is_none_if_the_best_class_has_one_member(ask):
    gallery = on_a_line([0.0, 1.0])
    assert ask(gallery, 999.0).known is None
    assert ask(gallery, 1000.0).known is None
    assert ask(gallery, 0.0, left_out=[0]).known is None


def test_a_stored_query_does_not_count_as_a_member_of_its_class(ask):
    gallery = on_a_line([0.0, 1.0, 2.0, 50.0])
    assert ask(gallery, 50.0).known is True
    assert ask(gallery, 50.0, left_out=[3]).known is False


def test_a_class_of_equal_members_knows_only_equal_queries(ask):
    gallery = on_a_line([5.0, 5.0, 5.0])
    assert ask(gallery, 5.0).known is True
    assert ask(gallery, 5.001).known is False


@pytest.mark.parametrize("classifier", ["vote", "mean", "discriminants"])
def test_the_best_class_of_each_classifier_decides(ask, classifier):
    gallery = on_a_line([0.0, 1.0, 2.0], [10.0, 11.0, 12.0])
    assert ask(gallery, 1.5, classifier).known is True
    assert ask(gallery, 5.0, classifier).known is False


@given(seeds, st.floats(0.01, 100))
def test_a_change_of_unit_does_not_change_whether_a_query_is_known(ask, clouds, seed, unit):
    gallery, query = clouds(seed), np.random.default_rng(seed).normal(size=4)
    scaled = Gallery((unit * gallery.vectors).astype(np.float32), gallery.codes, gallery.labels)
    near = ask(gallery, query).matches[0]
    if abs(ask(gallery, query).matches[1].distance - near.distance) > 1e-3:
        assert ask(scaled, unit * query).known == ask(gallery, query).known


def test_in_a_large_class_only_the_members_near_the_query_count(ask):
    # A dense end and a sparse end, each with more members than the calibration considers.
    dense, sparse = np.arange(0, 40, 0.1), np.arange(100, 4100, 10.0)
    gallery = on_a_line([*dense, *sparse])
    assert ask(gallery, -1.0).known is False
    assert ask(gallery, 4090.0 + 5.0).known is True
