"""Measures and ranking."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from unbend import Parameters, compare, compute_signature
from unbend.errors import ParameterError
from unbend.matching.measures import MEASURES
from unbend.matching.ranking import rank_shapes
from unbend.mesh.shapes import sheet, sphere, tetrahedron, torus


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
    with pytest.raises(ParameterError, match=", ".join(MEASURES)):
        compare(signature, signature, "volume")


@given(st.lists(st.floats(0, 10), min_size=1, max_size=30), st.integers(1, 40))
def test_shapes_are_ranked_by_distance_and_ties_by_place(distances, count):
    rows = rank_shapes(np.array(distances), count).tolist()
    expected = sorted(range(len(distances)), key=lambda row: (distances[row], row))
    assert rows == expected[:count]


def test_bent_sheets_are_nearer_to_each_other_than_to_anything_else():
    from unbend.mesh.shapes import cylinder, spiral

    members = [sheet(), cylinder(), spiral(), torus(), sphere()]
    signatures = [compute_signature(surface, Parameters(samples=150)) for surface in members]
    for measure in ("spectrum", "moments", "distribution"):
        inside = max(compare(signatures[0], other, measure) for other in signatures[1:3])
        outside = min(compare(signatures[0], other, measure) for other in signatures[3:])
        assert inside < 0.3 * outside, measure
