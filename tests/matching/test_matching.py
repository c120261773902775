"""Measures, ranking and the retrieval figures."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from unbend import Parameters, compare, compute_signature
from unbend.errors import ParameterError
from unbend.matching.evaluate import leave_one_out, nearest_class_accuracy
from unbend.matching.gallery import Gallery
from unbend.matching.measures import MEASURES, get_vector_measure
from unbend.matching.ranking import is_known, rank_classes, rank_shapes
from unbend.mesh.shapes import sheet, sphere, tetrahedron, torus

MOMENTS = get_vector_measure("moments")


def gallery_of(*labels):
    return Gallery.of(np.zeros((len(labels), 1)), labels)


@pytest.mark.parametrize("measure", MEASURES)
def test_measures_are_symmetric_zero_on_themselves_and_positive_between_shapes(measure):
    a, b = (compute_signature(surface, Parameters(samples=60)) for surface in (torus(), sphere()))
    assert compare(a, a, measure) == 0
    assert compare(a, b, measure) == compare(b, a, measure) > 0


def test_signatures_of_other_parameters_are_not_compared():
    a = compute_signature(sphere(subdivisions=1), Parameters(samples=20))
    b = compute_signature(sphere(subdivisions=1), Parameters(samples=21))
    with pytest.raises(ParameterError, match="different parameters"):
        compare(a, b)


def test_an_unknown_measure_names_the_known():
    signature = compute_signature(tetrahedron())
    with pytest.raises(ParameterError, match="spectrum, moments"):
        compare(signature, signature, "volume")


@given(st.lists(st.floats(0, 10), min_size=1, max_size=30), st.integers(1, 40))
def test_shapes_are_ranked_by_distance_and_ties_by_place(distances, count):
    rows = rank_shapes(np.array(distances), count).tolist()
    expected = sorted(range(len(distances)), key=lambda row: (distances[row], row))
    assert rows == expected[:count]


def test_a_class_is_as_far_as_its_nearest_member():
    ranked = rank_classes(np.array([3.0, 1.0, 2.0, 0.5]), gallery_of("a", "b", "a", None))
    assert [(match.label, match.distance) for match in ranked] == [("b", 1.0), ("a", 2.0)]
    assert sum(match.confidence for match in ranked) == pytest.approx(1.0)
    assert ranked[0].confidence == pytest.approx(2 / 3)


def test_an_exact_match_takes_all_confidence_and_no_labels_give_no_classes():
    ranked = rank_classes(np.array([0.0, 2.0]), gallery_of("a", "b"))
    assert ranked[0].confidence == pytest.approx(1.0, abs=1e-6)
    assert rank_classes(np.array([1.0]), gallery_of(None)) == []


def test_known_means_no_farther_than_the_class_is_wide():
    gallery = Gallery.of(np.array([[0.0], [1.0], [3.0], [50.0]]), ["a", "a", "a", "b"])

    def known(value: float):
        distances = MOMENTS.distances(np.array([value]), gallery.vectors)
        return is_known(gallery, MOMENTS, rank_classes(distances, gallery)[0])

    assert known(5.0) is True  # the member at 3 is 2 from its nearest
    assert known(5.1) is False
    assert known(49.0) is None  # a single member says nothing
    assert is_known(gallery, MOMENTS, None) is None


def test_figures_of_a_perfect_ranking_are_one():
    labels = ["a"] * 40 + ["b"] * 40
    distances = np.abs(np.arange(80)[:, None] - np.arange(80)) + 1000.0 * np.not_equal.outer(labels, labels)
    figures = leave_one_out(distances, labels)
    assert (figures.nn, figures.ft, figures.st, figures.dcg, figures.map) == (
        1,
        1,
        1,
        pytest.approx(1),
        pytest.approx(1),
    )
    assert figures.e == pytest.approx(2 / (1 + 39 / 32))  # 32 places hold 32 of 39 members


def test_figures_of_a_ranking_counted_by_hand():
    # Query 0 sees b, a, c, a: its two others at ranks 2 and 4. Queries 2 and 4 see all at one distance, so in the
    # order of the rows: a, b, c, a and a, b, a, c. The classes b and c have one member and ask nothing.
    distances = np.full((5, 5), 9.0)
    distances[0] = [0, 1, 2, 3, 4]
    figures = leave_one_out(distances, ["a", "b", "a", "c", "a"])
    gain = {1: 1.0, 2: 1.0, 3: 1 / np.log2(3), 4: 1 / np.log2(4)}
    assert figures.nn == pytest.approx(np.mean([0, 1, 1]))
    assert figures.ft == pytest.approx(np.mean([1 / 2, 1 / 2, 1 / 2]))
    assert figures.st == pytest.approx(1.0)
    assert figures.e == pytest.approx(2 / (32 / 2 + 1))
    assert figures.dcg == pytest.approx(np.mean([gain[2] + gain[4], gain[1] + gain[4], gain[1] + gain[3]]) / 2)
    assert figures.map == pytest.approx(np.mean([(1 / 2 + 2 / 4) / 2, (1 + 2 / 4) / 2, (1 + 2 / 3) / 2]))


def test_evaluation_needs_a_class_of_two_and_matching_labels():
    with pytest.raises(ParameterError, match="two members"):
        leave_one_out(np.zeros((2, 2)), ["a", "b"])
    with pytest.raises(ParameterError, match="3 labels"):
        leave_one_out(np.zeros((2, 2)), ["a", "b", "c"])


def test_accuracy_counts_missing_answers_as_wrong():
    assert nearest_class_accuracy(["a", None, "b", "b"], ["a", "a", "b", "a"]) == 0.5
    with pytest.raises(ParameterError):
        nearest_class_accuracy([], [])


def test_bent_sheets_are_nearer_to_each_other_than_to_anything_else():
    from unbend.mesh.shapes import cylinder, spiral

    members = [sheet(), cylinder(), spiral(), torus(), sphere()]
    signatures = [compute_signature(surface, Parameters(samples=150)) for surface in members]
    for measure in ("spectrum", "moments", "distribution"):
        inside = max(compare(signatures[0], other, measure) for other in signatures[1:3])
        outside = min(compare(signatures[0], other, measure) for other in signatures[3:])
        assert inside < 0.3 * outside, measure
