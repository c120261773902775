"""The Surface value."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from unbend import Surface
from unbend.errors import MeshGeometryError

TRIANGLE = [[0, 0, 0], [2, 0, 0], [0, 1, 0]]


def test_areas_sum_to_the_total():
    surface = Surface([*TRIANGLE, [2, 1, 0], [9, 9, 9]], [[0, 1, 2], [1, 3, 2]])
    assert surface.area == pytest.approx(2.0)
    assert surface.vertex_areas.sum() == pytest.approx(2.0)
    assert surface.vertex_areas[4] == 0


def test_it_cannot_be_changed_and_does_not_share_the_callers_arrays():
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
        ([[0, 0, np.nan], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], "vertex 0"),
    ],
)
def test_what_is_no_surface_is_refused(vertices, faces, message):
    with pytest.raises(MeshGeometryError, match=message):
        Surface(vertices, faces)


def test_an_unused_vertex_may_be_anything():
    assert Surface([*TRIANGLE, [np.nan] * 3], [[0, 1, 2]]).area == pytest.approx(1.0)
