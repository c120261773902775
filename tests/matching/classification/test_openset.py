"""Known or unknown: how far a query may be from a class."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from unbend.matching.classification.calibration import calibration_of
from unbend.matching.gallery import Gallery

SLACK = calibration_of("moments").slack
seeds = st.integers(0, 2**32 - 1)


def on_a_line(a, b=(1000.0,)):
    return Gallery.of(np.array([[place] for place in (*a, *b)], np.float32), ["a"] * len(a) + ["b"] * len(b))


def test_a_query_is_known_up_to_some_times_the_mean_distance_of_members_to_their_nearest(ask):
    gallery = on_a_line([0.0, 1.0, 3.0])  # 1, 1 and 2 from their nearest
    edge = 3.0 + SLACK * 4 / 3
    assert ask(gallery, edge - 1e-3).known is True
    assert ask(gallery, edge + 1e-3).known is False
    assert ask(gallery, 2.0).known is True


def test_a_single_member_says_nothing(ask):
    gallery = on_a_line([0.0, 1.0])
    assert ask(gallery, 999.0).known is None
    assert ask(gallery, 1000.0).known is None
    assert ask(gallery, 0.0, left_out=[0]).known is None


def test_a_stored_query_does_not_vouch_for_itself(ask):
    gallery = on_a_line([0.0, 1.0, 2.0, 50.0])
    assert ask(gallery, 50.0).known is True
    assert ask(gallery, 50.0, left_out=[3]).known is False


def test_members_that_are_all_alike_are_known_by_nothing_else(ask):
    gallery = on_a_line([5.0, 5.0, 5.0])
    assert ask(gallery, 5.0).known is True
    assert ask(gallery, 5.001).known is False


@pytest.mark.parametrize("classifier", ["vote", "mean", "discriminants"])
def test_it_is_the_best_class_that_is_looked_at_whoever_chose_it(ask, classifier):
    gallery = on_a_line([0.0, 1.0, 2.0], [10.0, 11.0, 12.0])
    assert ask(gallery, 1.5, classifier).known is True
    assert ask(gallery, 5.0, classifier).known is False


@given(seeds, st.floats(0.01, 100))
def test_a_change_of_unit_changes_nothing(ask, clouds, seed, unit):
    gallery, query = clouds(seed), np.random.default_rng(seed).normal(size=4)
    scaled = Gallery((unit * gallery.vectors).astype(np.float32), gallery.codes, gallery.labels)
    near = ask(gallery, query).matches[0]
    if abs(ask(gallery, query).matches[1].distance - near.distance) > 1e-3:
        assert ask(scaled, unit * query).known == ask(gallery, query).known


def test_in_a_large_class_it_is_the_members_near_the_query_that_count(ask):
    # a dense end and a sparse one, both of more members than are looked at
    dense, sparse = np.arange(0, 40, 0.1), np.arange(100, 4100, 10.0)
    gallery = on_a_line([*dense, *sparse])
    assert ask(gallery, -1.0).known is False
    assert ask(gallery, 4090.0 + 5.0).known is True
