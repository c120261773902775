"""All measures are symmetric, zero on equal signatures, and reproducible."""

from __future__ import annotations

import pytest

from unbend import Parameters, compare, compute_signature
from unbend.errors import ParameterError
from unbend.matching.measures import MEASURES
from unbend.mesh.shapes import sheet, sphere, tetrahedron, torus


@pytest.mark.parametrize("measure", MEASURES)
def test_measures_are_symmetric_zero_on_equal_and_positive_on_different_shapes(measure):
    a, b = (compute_signature(surface, Parameters(samples=60)) for surface in (torus(), sphere()))
    assert compare(a, a, measure) == 0
    assert compare(a, b, measure) == compare(b, a, measure) > 0


def test_signatures_with_different_parameters_are_not_compared():
    a = compute_signature(sphere(subdivisions=1), Parameters(samples=20))
    b = compute_signature(sphere(subdivisions=1), Parameters(samples=21))
    with pytest.raises(ParameterError, match="different parameters"):
        compare(a, b)


def test_an_unknown_measure_is_refused_with_the_known_ones():
    signature = compute_signature(tetrahedron())
    with pytest.raises(ParameterError, match=", ".join(MEASURES)):
        compare(signature, signature, "volume")


@pytest.mark.parametrize("measure", MEASURES)
def test_measures_do_not_depend_on_the_run_or_the_number_of_threads(measure):
    found = set()
    for threads in (1, 2, 1):
        a, b = (compute_signature(surface, Parameters(samples=80), threads=threads) for surface in (torus(), sheet()))
        found.add(compare(a, b, measure))
    assert len(found) == 1


def test_bent_sheets_are_nearer_to_each_other_than_to_other_shapes():
    from unbend.mesh.shapes import cylinder, spiral

    members = [sheet(), cylinder(), spiral(), torus(), sphere()]
    signatures = [compute_signature(surface, Parameters(samples=150)) for surface in members]
    for measure in ("spectrum", "moments", "distribution"):
        inside = max(compare(signatures[0], other, measure) for other in signatures[1:3])
        outside = min(compare(signatures[0], other, measure) for other in signatures[3:])
        assert inside < 0.3 * outside, measure
