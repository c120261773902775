"""Reeb graphs of the mean geodesic distance: known graphs, and a matching that does not depend on order."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from unbend import Parameters, compute_signature, geodesic_matrix
from unbend.descriptors.reeb import LEVELS, ReebGraph, reeb_graph
from unbend.matching.measures.pairs import REEB
from unbend.mesh.shapes import bent_tube, figure, sheet, sphere, spiral


def counts(vector: np.ndarray) -> list[int]:
    """Return the number of parts for 8, 4, 2 and 1 intervals."""
    graph, found = ReebGraph.unpack(vector), []
    for _ in range(LEVELS):
        found.append(len(graph.intervals))
        graph, _ = graph.coarser()
    return found


def chain(lengths: list[float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a star of arms of these lengths: distances, degenerate triangles, and equal weights."""
    at = np.concatenate([[0.0], *(np.linspace(0, length, 41)[1:] for length in lengths)])
    arm = np.concatenate([[-1], *(np.full(40, place) for place in range(len(lengths)))])
    distances = np.where((arm[:, None] == arm) & (arm >= 0), np.abs(at[:, None] - at), at[:, None] + at)
    steps = [[0 if step == 0 else 40 * a + step, 40 * a + step + 1] for a in range(len(lengths)) for step in range(40)]
    faces = np.array([[i, j, j] for i, j in steps], np.int32)
    return distances, faces, np.full(len(at), 1 / len(at))


def test_the_graph_of_a_star_has_one_part_in_the_middle_and_parts_for_each_arm():
    # With n arms of length 1, the mean distance rises along each arm from 1/2 in the middle to 3/2 - 1/n at the end,
    # so its range is (1 - 1/n) / (3/2 - 1/n) of its maximum.
    for arms in (3, 4, 5):
        graph = reeb_graph(*chain([1.0] * arms))
        top = (1 - 1 / arms) / (3 / 2 - 1 / arms)
        above = int(np.ceil(top * 8)) - 1
        assert counts(graph.pack())[0] == 1 + arms * above
        assert len(graph.edges) == arms * above
        assert graph.areas.sum() == pytest.approx(1)


def test_the_graph_of_a_line_has_two_ends_and_coarser_graphs_join_parts():
    distances, faces, weights = chain([1.0, 1.0])
    graph = reeb_graph(distances, faces, weights)
    # The mean distance is 1/2 in the middle and 1 at the ends, so only the ends reach the upper half of the intervals.
    assert counts(graph.pack())[1:] in ([3, 1, 1], [5, 3, 1])
    coarse, within = graph.coarser()
    np.testing.assert_allclose(np.bincount(within, graph.areas), coarse.areas)
    np.testing.assert_array_equal(coarse.intervals[within], graph.intervals // 2)
    assert (coarse.lows[within] <= graph.lows).all()


def test_the_graph_of_a_sphere_is_one_part_and_of_a_tube_a_line():
    ball, tube = (compute_signature(surface).descriptors["reeb"] for surface in (sphere(3), bent_tube("helix")))
    assert counts(ball) == [1, 1, 1, 1]
    assert counts(tube)[2:] == [3, 1]


def test_unpacking_restores_the_packed_graph():
    graph = reeb_graph(*chain([1.0, 0.7, 0.4]))
    again = ReebGraph.unpack(graph.pack())
    for name in ("intervals", "areas", "lows", "highs", "edges"):
        np.testing.assert_array_equal(getattr(again, name), getattr(graph, name))


@given(st.lists(st.floats(0.2, 1.0), min_size=2, max_size=6), st.integers(0, 2**32 - 1))
def test_the_distance_is_symmetric_and_independent_of_the_order_of_samples(signature_of, lengths, seed):
    distances, faces, weights = chain(lengths)
    order = np.random.default_rng(seed).permutation(len(weights))
    place = np.argsort(order)
    one, same, other = (
        with_graph(signature_of, graph)
        for graph in (
            reeb_graph(distances, faces, weights),
            reeb_graph(distances[np.ix_(order, order)], place[faces], weights[order]),
            reeb_graph(*chain([1.0, 0.5, 0.25])),
        )
    )
    assert REEB.distance(one, same) < 1e-9
    assert REEB.distance(one, other) == pytest.approx(REEB.distance(other, one), abs=1e-12)
    assert REEB.distance(same, other) == pytest.approx(REEB.distance(one, other), abs=1e-9)
    assert 0 <= REEB.distance(one, other) < 1


def with_graph(signature_of, graph):
    signature = signature_of(np.eye(3))
    signature.descriptors["reeb"] = graph.pack()
    return signature


def test_poses_of_a_shape_are_nearer_than_other_shapes():
    few = Parameters(samples=200)
    poses = [
        [compute_signature(surface, few) for surface in of]
        for of in (
            [figure("quadruped", 0), figure("quadruped", 1)], [figure("spider", 0), figure("spider", 1)],
            [sheet(), spiral()], [bent_tube("straight"), bent_tube("knot")],
        )
    ]  # fmt: skip
    within = max(REEB.distance(*of) for of in poses)
    between = min(
        REEB.distance(a, b) for i, of in enumerate(poses[:2]) for others in poses[i + 1 :] for a in of for b in others
    )
    assert within < 0.6 * between


def test_the_graph_of_a_signature_equals_that_of_its_geodesic_distances():
    surface = figure("bird", seed=0)
    found = compute_signature(surface, Parameters(samples=80))
    again = reeb_graph(geodesic_matrix(surface, found.samples), found.faces, found.weights)
    np.testing.assert_allclose(found.descriptors["reeb"], again.pack(), rtol=1e-9, atol=1e-12)
