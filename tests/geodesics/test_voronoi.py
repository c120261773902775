"""The geodesic Voronoi diagram."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.oracles import grid
from unbend import Surface, geodesic_distances, geodesic_voronoi
from unbend.errors import ParameterError
from unbend.mesh.shapes import sphere, torus


@pytest.mark.parametrize("update", ["spherical", "planar"])
def test_each_vertex_belongs_to_its_nearest_source(update):
    surface = torus(columns=40, rows=25)
    sources = np.arange(0, 1000, 83)
    diagram = geodesic_voronoi(surface, sources, update=update)
    rows = geodesic_distances(surface, sources, update=update)
    nearest = rows.min(axis=0)
    # A front stops where it meets another front, so distances near the meeting line may be slightly too long.
    np.testing.assert_allclose(diagram.distances, nearest, rtol=0.02, atol=1e-9)
    assert (rows[diagram.nearest, np.arange(1000)] <= nearest * 1.02 + 1e-9).all()
    np.testing.assert_array_equal(diagram.nearest[sources], np.arange(len(sources)))


def test_two_sources_divide_a_strip_into_halves():
    surface = grid(40, 4)
    diagram = geodesic_voronoi(surface, [82, 122])  # the ends of the middle row
    x = surface.vertices[:, 0]
    assert (diagram.nearest[x < 20] == 0).all()
    assert (diagram.nearest[x > 20] == 1).all()
    assert diagram.areas.sum() == pytest.approx(surface.area)
    assert diagram.areas == pytest.approx([80, 80], abs=2.01)  # ties decide about the middle column


def test_a_repeated_source_has_one_cell_and_unreachable_vertices_have_none():
    ball = sphere(subdivisions=1)
    far = Surface(np.concatenate([ball.vertices, ball.vertices + 9]), np.concatenate([ball.faces, ball.faces + 42]))
    diagram = geodesic_voronoi(far, [3, 3])
    assert (diagram.nearest[:42] == 0).all()
    assert (diagram.nearest[42:] == -1).all()
    assert np.isinf(diagram.distances[42:]).all()
    assert diagram.areas == pytest.approx([ball.area, 0.0])


@pytest.mark.parametrize("arguments", [{"sources": [99]}, {"sources": []}, {"sources": 0, "update": "cubic"}])
def test_wrong_arguments_are_refused(arguments):
    with pytest.raises(ParameterError):
        geodesic_voronoi(grid(2, 2), **arguments)
