"""Separation of classes, compared with hand computations and with the paper's result on bent surfaces."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from unbend import Parameters, compute_signature
from unbend.matching.evaluate import clusters, separation
from unbend.mesh.shapes import cylinder, helicoid_catenoid, sheet, sphere, spiral
from unbend.signature.dimensions import moments_over_dimensions


def test_clusters_equal_hand_computed_values():
    places = np.array([[0.0], [1.0], [10.0], [12.0], [2.5]])
    found = clusters(cdist(places, places), ["a", "a", "b", "b", "b"])
    # The shape nearest to the last one (at 2.5) is of the other class.
    assert found.nearest == pytest.approx(4 / 5)
    within = (1 * 2 + 2 * 2 + 7.5 * 2 + 9.5 * 2) / 8
    between = np.mean([10, 12, 2.5, 9, 11, 1.5])
    assert found.ratio == pytest.approx(between / within)


@pytest.mark.parametrize(("places", "labels"), [([[0.0]], ["a"]), ([[0.0], [1.0]], ["a", "b"])])
def test_classes_of_one_member_have_no_ratio(places, labels):
    found = clusters(cdist(places, places), labels)
    assert (found.nearest, found.ratio) == (None, None)


def test_one_class_or_equal_members_have_no_ratio():
    assert clusters(np.array([[0.0, 1.0], [1.0, 0.0]]), ["a", "a"]).ratio is None
    same = clusters(np.array([[0.0, 0, 1], [0, 0, 1], [1, 1, 0]]), ["a", "a", "b"])
    assert (same.nearest, same.ratio) == (1.0, None)


def test_log_ratios_equal_hand_computed_values():
    # In one dimension the classes are around 0 and 10 with variances 1 and 4; in two, both variances are 0.01.
    vectors = np.array([[[-1.0], [-0.1]], [[1.0], [0.1]], [[8.0], [9.9]], [[12.0], [10.1]], [[5.0], [5.0]]])
    found = separation({"some": vectors}, ["a", "a", "b", "b", "alone"])
    assert found.pairs == [("a", "b")]
    assert found.medians["some"] == pytest.approx([np.log(100 / 5), np.log(100 / 0.02)])
    assert json.loads(json.dumps(found.as_dict()))["ratios"]["some"][0] == pytest.approx([np.log(20)])


def test_classes_of_one_member_give_no_pairs():
    found = separation({"some": np.zeros((2, 3, 4))}, ["a", "b"])
    assert found.pairs == []


def test_equal_classes_and_classes_without_a_variance_have_finite_ratios():
    vectors = np.array([[[0.0]], [[0.0]], [[1.0]], [[1.0]]])
    assert np.isfinite(separation({"some": vectors}, ["a", "a", "b", "b"]).medians["some"]).all()
    assert np.isfinite(separation({"some": 0 * vectors}, ["a", "a", "b", "b"]).medians["some"]).all()


@pytest.mark.parametrize("method", ["least_squares", "classical"])
def test_moments_over_dimensions_equal_those_of_signatures(method):
    surface = spiral(columns=20, rows=10)
    few = Parameters(samples=60)
    found = moments_over_dimensions(surface, few, most=4)[method]
    assert found.shape == (4, 14)
    for dimensions in range(1, 5):
        expected = compute_signature(surface, Parameters(samples=60, dimensions=dimensions, method=method)).moments
        np.testing.assert_allclose(found[dimensions - 1], expected, rtol=1e-6, atol=1e-7)


def test_signatures_of_bent_surfaces_form_clusters_but_the_surfaces_do_not():
    members = {
        "sheet": [sheet(), cylinder(), spiral()],
        "saddle": [helicoid_catenoid(t) for t in (0.0, 0.8, 1.5)],
        "ball": [sphere(2), sphere(3)],
    }
    found = [(compute_signature(surface), label) for label, of in members.items() for surface in of]
    labels = [label for _, label in found]
    bent, unbent = (
        np.stack([signature.descriptors[name] for signature, _ in found]) for name in ("surface_moments", "moments")
    )
    assert clusters(cdist(unbent, unbent), labels).nearest == 1.0
    assert clusters(cdist(unbent, unbent), labels).ratio > 5 * clusters(cdist(bent, bent), labels).ratio
