"""Confidences: what holds for them whatever the constants are."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from unbend.matching.classification import CLASSIFIERS
from unbend.matching.classification.calibration import CALIBRATIONS, calibration_of, confidences
from unbend.matching.measures import VECTOR_MEASURES

remote = st.lists(st.floats(0, 1e6), min_size=1, max_size=40).map(np.array)
exponents = st.floats(0.5, 50)


@given(remote, exponents)
def test_they_sum_to_one_and_fall_with_the_distance(remoteness, exponent):
    found = confidences(remoteness, exponent)
    assert found.sum() == pytest.approx(1.0)
    assert ((found >= 0) & (found <= 1)).all()
    order = np.argsort(remoteness, kind="stable")
    assert (np.diff(found[order]) <= 0).all()


@given(st.lists(st.floats(1e-3, 1e3), min_size=2, max_size=9).map(np.array), exponents, st.floats(1e-3, 1e3))
def test_a_change_of_unit_changes_nothing(remoteness, exponent, unit):
    assert confidences(unit * remoteness, exponent) == pytest.approx(confidences(remoteness, exponent), abs=1e-9)


def test_twice_as_far_is_two_to_the_exponent_times_less_likely():
    near, far = confidences(np.array([1.5, 3.0]), 5.0)
    assert near / far == pytest.approx(32.0)


def test_every_measure_and_classifier_has_constants_of_its_own():
    for measure in VECTOR_MEASURES:
        assert set(CALIBRATIONS[measure].exponents) == set(CLASSIFIERS), "run benchmarks/classification.py"
        assert calibration_of(measure) is CALIBRATIONS[measure]
        assert CALIBRATIONS[measure].slack > 0
        assert min(CALIBRATIONS[measure].exponents.values()) > 0
    assert calibration_of("another") is CALIBRATIONS["spectrum"]
