"""Reranking a short list by a pair measure."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from unbend import Parameters, compute_signature
from unbend.errors import ParameterError
from unbend.matching.measures import MEASURES
from unbend.matching.rerank import rerank
from unbend.matching.selection import smallest
from unbend.mesh.shapes import cylinder, ellipsoid, sheet, sphere, spiral, torus

RIGID, HAUSDORFF = MEASURES["rigid"], MEASURES["hausdorff"]


@cache
def signatures():
    surfaces = (sheet(), torus(), ellipsoid(), spiral(), sphere(), cylinder())
    return tuple(compute_signature(surface, Parameters(samples=80)) for surface in surfaces)


@pytest.mark.parametrize("measure", [RIGID, HAUSDORFF], ids=lambda measure: measure.name)
@pytest.mark.parametrize("threads", [None, 1, 2, 9])
def test_distances_equal_those_of_the_measure_on_any_number_of_threads(measure, threads):
    query, *candidates = signatures()
    found = rerank(query, candidates, measure, threads)
    np.testing.assert_array_equal(found, [measure.distance(query, candidate) for candidate in candidates])


def test_bent_copies_come_first():
    query, *candidates = signatures()
    assert set(smallest(rerank(query, candidates, RIGID), 2).tolist()) == {2, 4}


def test_a_query_among_its_candidates_has_distance_0():
    candidates = signatures()
    for row, query in enumerate(candidates):
        found = rerank(query, candidates, HAUSDORFF)
        assert found[row] == 0.0
        assert (np.delete(found, row) > 0).all()


def test_no_candidates_give_no_distances():
    assert rerank(signatures()[0], [], RIGID).shape == (0,)


def test_invalid_candidates_and_threads_are_refused():
    query, *candidates = signatures()
    other = compute_signature(sphere(subdivisions=2), Parameters(samples=81))
    with pytest.raises(ParameterError, match="different parameters"):
        rerank(query, [*candidates, other], RIGID)
    with pytest.raises(ParameterError, match="threads must be at least 1"):
        rerank(query, candidates, RIGID, 0)
    with pytest.raises(ParameterError, match="threads must be at least 1"):
        rerank(query, [], RIGID, 0)
