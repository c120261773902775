"""The correspondence between the vertices of a file and those of the surface read from it."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.server import ply, two_rings
from unbend import MeshPolicy, Surface, read_mesh
from unbend.errors import ParameterError
from unbend.mesh.correspondence import at_given_vertices, surface_vertex

WHOLE = two_rings(0, columns=40, rows=20)
LARGE = 800  # number of vertices of the large ring, which come first


def read(**policy: object) -> Surface:
    return read_mesh(ply(WHOLE), policy=MeshPolicy(**policy))


@pytest.mark.parametrize("components", ["largest", "bridge"])
def test_vertices_of_an_unsimplified_surface_keep_their_index(components):
    surface = read(components=components)
    assert [surface_vertex(surface, vertex, "source") for vertex in (0, LARGE, 817)] == [0, LARGE, 817]
    values = np.arange(818.0)
    np.testing.assert_array_equal(at_given_vertices(surface, values), values)


@pytest.mark.parametrize(("components", "left"), [("largest", LARGE), ("bridge", 818)])
def test_vertices_of_a_simplified_mesh_map_to_near_vertices(components, left):
    surface = read(components=components, max_vertices=300)
    assert len(surface.vertices) <= 300
    places = [surface_vertex(surface, vertex, "source") for vertex in range(left)]
    apart = np.linalg.norm(surface.vertices[places] - read().vertices[:left], axis=1)
    assert apart.mean() < 0.1
    assert apart.max() < 0.6  # the diameter of the large ring is 2.4
    values = at_given_vertices(surface, np.arange(float(len(surface.vertices))))
    np.testing.assert_array_equal(values[:left], places)
    assert np.isinf(values[left:]).all()
    assert len(values) == 818


def test_a_vertex_lost_in_simplification_is_refused_with_its_index_in_the_file():
    surface = read(max_vertices=300)
    with pytest.raises(ParameterError, match="target: vertex 800 was removed when the mesh was simplified"):
        surface_vertex(surface, LARGE, "target")


@pytest.mark.parametrize("policy", [{}, {"max_vertices": 300}])
@pytest.mark.parametrize("vertex", [-1, 818, 2**31 - 1])
def test_a_vertex_outside_the_file_is_refused(policy, vertex):
    with pytest.raises(ParameterError, match=f"source: the mesh has no vertex {vertex}, only 0 to 817"):
        surface_vertex(read(**policy), vertex, "source")
