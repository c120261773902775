"""The class `Surface`."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from unbend import Surface
from unbend.errors import MeshGeometryError
from unbend.mesh.report import MeshReport

TRIANGLE = [[0, 0, 0], [2, 0, 0], [0, 1, 0]]


def test_vertex_areas_sum_to_the_area():
    surface = Surface([*TRIANGLE, [2, 1, 0], [9, 9, 9]], [[0, 1, 2], [1, 3, 2]])
    assert surface.area == pytest.approx(2.0)
    assert surface.vertex_areas.sum() == pytest.approx(2.0)
    assert surface.vertex_areas[4] == 0


def test_a_surface_is_immutable_and_copies_its_arrays():
    vertices = np.array(TRIANGLE, float)
    surface = Surface(vertices, [[0, 1, 2]])
    vertices[0] = 7
    assert surface.vertices[0, 0] == 0
    with pytest.raises(ValueError, match="read-only"):
        surface.vertices[0] = 1
    with pytest.raises(dataclasses.FrozenInstanceError):
        surface.faces = None


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        (np.zeros((3, 2)), [[0, 1, 2]], r"\(n, 3\)"),
        (TRIANGLE, [[0, 1, 2, 0]], r"\(m, 3\)"),
        (TRIANGLE, np.empty((0, 3), int), "no faces"),
        (TRIANGLE, [[0, 1, 3]], "face 0"),
        (TRIANGLE, [[0, 1, -1]], "face 0"),
        (TRIANGLE, [[0, 1, 2**32 + 2]], "face 0"),
        (TRIANGLE, [[0, 1, 1.5]], "whole numbers"),
        (TRIANGLE, [[0, 1, np.nan]], "whole numbers"),
        ([[0, 0, np.nan], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], "vertex 0"),
        (1e150 * np.array(TRIANGLE), [[0, 1, 2]], "scale its coordinates"),
        (1e-150 * np.array(TRIANGLE), [[0, 1, 2]], "scale its coordinates"),
        ([[-1.7e308, 0, 0], [1.7e308, 0, 0], [0, 1, 0]], [[0, 1, 2]], "scale its coordinates"),
    ],
)
def test_invalid_arrays_are_refused(vertices, faces, message):
    with pytest.raises(MeshGeometryError, match=message):
        Surface(vertices, faces)


def test_an_unused_vertex_may_have_any_coordinates():
    assert Surface([*TRIANGLE, [np.nan] * 3], [[0, 1, 2]]).area == pytest.approx(1.0)


@pytest.mark.parametrize("scale", [1e-130, 1e-60, 1e60, 1e130])
def test_areas_of_tiny_and_huge_surfaces_are_correct(scale):
    surface = Surface(scale * np.array(TRIANGLE), [[0, 1, 2]])
    assert surface.area / scale / scale == pytest.approx(1.0)
    assert surface.extent == pytest.approx(2 * scale)


def test_the_extent_ignores_unused_vertices():
    assert Surface([*TRIANGLE, [9, 9, 9]], [[0, 1, 2]]).extent == 2


def test_used_vertices_are_sorted():
    np.testing.assert_array_equal(Surface([[7, 7, 7], *TRIANGLE], [[3, 1, 2]]).used_vertices, [1, 2, 3])


def test_edges_are_computed_once():
    surface = Surface(TRIANGLE, [[0, 1, 2]])
    assert surface.edges is surface.edges
    assert surface.edges.boundary == 3


def test_a_copy_with_another_report_shares_all_arrays():
    surface = Surface(TRIANGLE, [[0, 1, 2]])
    edges = surface.edges
    other = surface.with_report(MeshReport(faces=7))
    assert (surface.report.faces, other.report.faces) == (0, 7)
    assert other.edges is edges
    assert other.vertices is surface.vertices
