"""Linking components: the result is one surface with the shortest links, and distances follow the links."""

from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree
from scipy.spatial.distance import cdist

from unbend import MeshPolicy, geodesic_distances, read_mesh
from unbend.mesh.repair import repair
from unbend.mesh.shapes import sheet, sphere, tetrahedron

BRIDGE = MeshPolicy(components="bridge")


def copies(shape, offsets):
    """Return one mesh with a copy of a shape at each offset."""
    size = len(shape.vertices)
    vertices = (np.asarray(offsets, float)[:, None] + shape.vertices).reshape(-1, 3)
    return vertices, (size * np.arange(len(offsets))[:, None, None] + shape.faces).reshape(-1, 3)


def component_count(surface):
    a, b, c = surface.faces.T
    size = len(surface.vertices)
    rows, columns = np.concatenate([a, b]), np.concatenate([b, c])
    graph = coo_array((np.ones(len(rows)), (rows, columns)), shape=(size, size))
    count = connected_components(graph, return_labels=False)
    return count - (size - len(np.unique(surface.faces)))


def links_of(surface):
    """Return the face of each link; the first two corners of the face are the ends of the link."""
    return surface.faces[len(surface.faces) - surface.report.links :]


def shortest_tree(vertices, component):
    """Return the weight of the minimum spanning tree of components, from the distances between all vertices."""
    count = component.max() + 1
    nearest = np.full((count, count), np.inf)
    np.minimum.at(nearest, (component[:, None], component[None]), cdist(vertices, vertices))
    weights = nearest + 1.0  # because a sparse graph treats zeros as missing edges
    return minimum_spanning_tree(weights - np.diag(np.diag(weights))).sum() - (count - 1)


@given(
    st.lists(st.tuples(*[st.integers(-4, 4)] * 3), min_size=2, max_size=12, unique=True),
    st.sampled_from([0.3, 1.0, 2.0]),
)
def test_links_join_all_components_by_a_minimum_spanning_tree(offsets, size):
    vertices, faces = copies(tetrahedron(size), offsets)
    surface = repair(vertices, faces, policy=BRIDGE)
    assert component_count(surface) == 1
    assert surface.report.components == len(offsets)
    np.testing.assert_array_equal(surface.vertices, vertices)
    np.testing.assert_array_equal(surface.faces[: len(faces)], faces)
    ends = surface.vertices[links_of(surface)[:, :2]]
    lengths = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
    assert len(lengths) == len(offsets) - 1
    assert lengths.sum() == pytest.approx(shortest_tree(vertices, np.repeat(np.arange(len(offsets)), 4)), abs=1e-9)
    assert surface.report.longest_link == pytest.approx(lengths.max())


def test_links_of_scattered_components_are_a_minimum_spanning_tree():
    generator = np.random.default_rng(3)
    offsets = generator.random((40, 3)) * [20, 5, 1]
    vertices, faces = copies(sphere(1, radius=0.4), offsets)
    surface = repair(vertices, faces, policy=BRIDGE)
    ends = surface.vertices[links_of(surface)[:, :2]]
    component = np.repeat(np.arange(40), len(vertices) // 40)
    assert np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).sum() == pytest.approx(shortest_tree(vertices, component))


def test_distances_along_links_are_the_lengths_of_the_links():
    vertices, faces = copies(sphere(2), [[0, 0, 0], [3.5, 0, 0]])
    surface = repair(vertices, faces, policy=BRIDGE)
    near, far = links_of(surface)[0, :2]
    length = surface.report.longest_link
    assert length == pytest.approx(1.5, rel=0.05)
    distances = geodesic_distances(surface, near)[0]
    assert np.isfinite(distances).all()
    assert distances[far] == pytest.approx(length)
    alone = geodesic_distances(surface, far)[0]
    other_side = (np.arange(len(vertices)) < len(vertices) // 2) == (far < len(vertices) // 2)
    np.testing.assert_allclose(distances[other_side], length + alone[other_side], rtol=0.02)


def test_touching_components_are_linked_without_length_or_area():
    square = sheet(columns=3, rows=3)
    vertices, faces = copies(square, [[0, 0, 0], [np.ptp(square.vertices[:, 0]), 0, 0]])
    surface = repair(vertices, faces, policy=MeshPolicy(components="bridge", seams="keep"))
    assert (surface.report.links, surface.report.longest_link, surface.report.link_area) == (1, 0.0, 0.0)
    assert surface.report.coincident_vertices == 4
    distances = geodesic_distances(surface, int(links_of(surface)[0, 0]))[0]
    assert np.isfinite(distances).all()
    assert distances[links_of(surface)[0, 1]] < 1e-9 * surface.extent  # edges of length zero get a tiny length


def test_the_area_of_links_is_minimal_and_reported():
    vertices, faces = copies(sphere(1), [[0, 0, 0], [4, 1, 0], [0, 5, 2]])
    surface = repair(vertices, faces, policy=BRIDGE)
    assert surface.report.link_area == pytest.approx(surface.area - 3 * sphere(1).area)
    for a, b, third in links_of(surface):
        beside = [face for face in faces if a in face or b in face]
        areas = [
            np.linalg.norm(np.cross(vertices[b] - vertices[a], vertices[c] - vertices[a])) / 2
            for c in {corner for face in beside for corner in face} - {a, b}
        ]
        own = np.linalg.norm(np.cross(vertices[b] - vertices[a], vertices[third] - vertices[a])) / 2
        assert own == pytest.approx(min(areas))


def test_isolated_vertices_are_not_linked():
    vertices, faces = copies(tetrahedron(), [[0, 0, 0], [3, 0, 0]])
    surface = repair(np.concatenate([vertices, [[9, 9, 9]]]), faces, policy=BRIDGE)
    assert surface.report.links == 1
    assert surface.report.isolated_vertices == 1


def test_a_connected_mesh_gets_no_links():
    ball = sphere(1)
    surface = repair(ball.vertices, ball.faces, policy=BRIDGE)
    np.testing.assert_array_equal(surface.faces, ball.faces)
    assert surface.report.links == 0


def test_links_do_not_depend_on_the_unit():
    vertices, faces = copies(tetrahedron(), np.random.default_rng(0).random((20, 3)) * 9)
    here, far = (repair(scale * vertices, faces, policy=BRIDGE) for scale in (1.0, 2.0**-400))
    np.testing.assert_array_equal(here.faces, far.faces)
    assert far.report.longest_link * 2.0**400 == pytest.approx(here.report.longest_link)


def test_ten_thousand_components_are_linked_in_seconds():
    vertices, faces = copies(tetrahedron(), np.random.default_rng(1).random((10_000, 3)) * 100)
    repair(vertices[:8], faces[:8], policy=BRIDGE)  # compiles
    started = time.process_time()
    surface = repair(vertices, faces, policy=BRIDGE)
    assert time.process_time() - started < 20  # usually one or two seconds
    assert component_count(surface) == 1


def test_damaged_real_meshes_become_one_component(labelled):
    for path, row in labelled("dirty"):
        surface = read_mesh(path, policy=MeshPolicy(components="bridge", seams="keep"))
        assert component_count(surface) == 1, path.name
        assert surface.report.links == int(row["components"]) - 1, path.name
        assert surface.report.link_area < 0.01 * surface.area, path.name
