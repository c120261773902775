"""Contours compared with known curves, and properties of every contour."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.oracles import grid
from tests.support.polylines import distance_from_surface, length
from unbend import Surface, geodesic_distances, read_mesh
from unbend.errors import ParameterError
from unbend.geodesics.contours import iso_contours
from unbend.mesh.shapes import sphere, torus

seeds = st.integers(0, 2**32 - 1)


def is_closed(line: np.ndarray) -> bool:
    return bool((line[0] == line[-1]).all())


@pytest.mark.parametrize("height", [-0.7, 0.0, 0.4])
def test_contours_converge_to_circles_of_latitude_at_second_order(height):
    errors = []
    for subdivisions in (3, 4, 5):
        ball = sphere(subdivisions)
        ((line,),) = iso_contours(ball, ball.vertices[:, 2], height)
        assert is_closed(line)
        np.testing.assert_allclose(line[:, 2], height, atol=1e-12)
        errors.append(1 - length(line) / (2 * math.pi * math.sqrt(1 - height**2)))
    assert errors[0] > 3 * errors[1] > 9 * errors[2] > 0


def test_contours_of_distance_on_a_flat_sheet_are_circles_and_arcs():
    surface = grid(60, 60)
    middle = 30 * 61 + 30
    levels = np.array([10.0, 25.5, 35.0])
    inner, near, cut = iso_contours(surface, geodesic_distances(surface, middle)[0], levels)
    for (line,), radius in ((inner, 10.0), (near, 25.5)):
        assert is_closed(line)
        np.testing.assert_allclose(np.linalg.norm(line - surface.vertices[middle], axis=1), radius, rtol=2e-3)
        assert length(line) == pytest.approx(2 * math.pi * radius, rel=2e-3)
    assert len(cut) == 4  # a circle of radius 35 leaves the sheet, whose sides are 30 away
    assert not any(is_closed(line) for line in cut)
    angle = 2 * math.pi - 8 * math.acos(30 / 35)
    assert sum(map(length, cut)) == pytest.approx(35 * angle, rel=5e-3)


def test_a_contour_through_vertices_has_no_gaps():
    surface = grid(6, 4)
    ((line,),) = iso_contours(surface, surface.vertices[:, 0], 3.0)  # along the edges at x = 3
    np.testing.assert_array_equal(line[:, 0], 3)
    assert sorted(line[:, 1].tolist()) == [0, 1, 2, 3, 4]
    ((line,),) = iso_contours(surface, surface.vertices[:, 0] + surface.vertices[:, 1], 4.0)
    assert length(line) == pytest.approx(4 * math.sqrt(2))
    assert len(line) == 5 + 4  # five vertices and the midpoints of four diagonals
    steps = np.diff(line, axis=0)
    np.testing.assert_allclose(steps, np.broadcast_to(steps[0], steps.shape), atol=1e-12)


def test_plateaus_have_contours_but_peaks_at_the_level_have_none():
    surface = grid(6, 6)
    plateau = (np.abs(surface.vertices[:, :2] - 3).max(axis=1) <= 1).astype(float)
    ((line,),) = iso_contours(surface, plateau, 1.0)
    assert is_closed(line)
    assert length(line) == pytest.approx(8)
    peak = np.arange(49) == 24
    assert iso_contours(surface, peak.astype(float), [1.0, -1.0, 2.0, 0.0]) == ((), (), (), ())
    assert iso_contours(surface, np.ones(49), 1.0) == ((),)


def test_contours_stop_at_infinite_values():
    surface = grid(8, 4)
    values = surface.vertices[:, 0].copy()
    values[surface.vertices[:, 1] > 2] = np.inf
    ((line,),) = iso_contours(surface, values, 3.5)
    assert line[:, 1].max() == 2
    assert length(line) == pytest.approx(2)
    assert iso_contours(surface, np.full(45, np.inf), 3.5) == ((),)
    assert iso_contours(surface, np.where(values > 4, -np.inf, values), 6.5) == ((),)


def test_contours_end_at_non_manifold_edges_and_ignore_degenerate_faces():
    points = [[0, 0, 0], [0, 2, 0], [1, 1, 0], [-1, 1, 0], [0, 1, 1]]
    surface = Surface(points, [[0, 1, 2], [1, 0, 3], [0, 1, 4], [1, 1, 2], [0, 0, 0]])
    (lines,) = iso_contours(surface, surface.vertices[:, 1], 0.5)
    assert len(lines) == 3
    for line in lines:
        assert min(np.linalg.norm(line[end] - [0, 0.5, 0]) for end in (0, -1)) < 1e-12


@pytest.mark.parametrize("name", ["teapot", "cow"])
def test_contours_of_distance_lie_on_damaged_real_meshes(shared_data, name):
    surface = read_mesh(shared_data / "dirty" / f"{name}.obj")
    values = geodesic_distances(surface, surface.used_vertices[0])[0]
    largest = values[np.isfinite(values)].max()
    for lines in iso_contours(surface, values, [0.3 * largest, 0.6 * largest]):
        assert lines
        assert all(distance_from_surface(surface, line) < 1e-12 * largest for line in lines)


@given(seeds, st.booleans())
@settings(max_examples=60)
def test_contours_have_the_length_in_every_triangle_and_end_only_at_the_border(seed, whole):
    rng = np.random.default_rng(seed)
    surface = torus(columns=9, rows=7) if seed % 2 else grid(7, 6)
    size = len(surface.vertices)
    values = rng.integers(0, 4, size).astype(float) if whole else rng.normal(size=size)  # integers may equal the level
    level = float(rng.integers(1, 4)) if whole else float(rng.normal())
    (lines,) = iso_contours(surface, values, level)
    a, b, c = (values[surface.faces[:, corner]] for corner in range(3))
    corners = surface.vertices[surface.faces]
    expected = 0.0  # sum of the lengths in the triangles
    for triangle, triple in zip(corners, np.stack([a, b, c], axis=1), strict=True):
        below = triple < level
        if 0 < below.sum() < 3:
            alone = int(np.flatnonzero(below == (below.sum() == 1))[0])
            others = [(alone + 1) % 3, (alone + 2) % 3]
            share = (level - triple[alone]) / (triple[others] - triple[alone])
            ends = triangle[alone] + share[:, None] * (triangle[others] - triangle[alone])
            expected += float(np.linalg.norm(ends[1] - ends[0]))
    assert sum(map(length, lines)) == pytest.approx(expected)
    assert all(len(line) > 1 and (line[1:] != line[:-1]).any(axis=1).all() for line in lines)
    assert all(distance_from_surface(surface, line) < 1e-12 for line in lines)
    ends = [line[end] for line in lines if not is_closed(line) for end in (0, -1)]
    border = {0.0, 7.0}, {0.0, 6.0}
    assert all(end[0] in border[0] or end[1] in border[1] for end in ends)
    assert seed % 2 == 0 or not ends  # a torus has no border


@given(seeds)
def test_contours_do_not_depend_on_numbering_or_orientation(seed):
    rng = np.random.default_rng(seed)
    surface = sphere(2)
    values = surface.vertices @ rng.normal(size=3)
    order = rng.permutation(len(values))
    faces = np.argsort(order)[surface.faces][rng.permutation(len(surface.faces))]
    faces = np.array([face[:: rng.choice([-1, 1])] for face in faces])
    (first,), (second,) = (
        iso_contours(surface, values, 0.2),
        iso_contours(Surface(surface.vertices[order], faces), values[order], 0.2),
    )
    assert sorted(map(len, first)) == sorted(map(len, second))
    assert sum(map(length, first)) == pytest.approx(sum(map(length, second)))


@pytest.mark.parametrize(
    ("values", "levels", "message"),
    [
        (np.zeros(8), 1.0, r"values must be \(9,\)"),
        (np.full(9, np.nan), 1.0, "not a number"),
        (np.zeros(9), np.inf, "finite"),
        (np.zeros(9), [[1.0]], "finite numbers"),
    ],
)
def test_wrong_arguments_are_refused(values, levels, message):
    with pytest.raises(ParameterError, match=message):
        iso_contours(grid(2, 2), values, levels)


def test_values_of_unused_vertices_are_ignored():
    flat = grid(2, 2)
    surface = Surface([*flat.vertices, [9, 9, 9]], flat.faces)
    ((line,),) = iso_contours(surface, np.append(flat.vertices[:, 0], np.nan), 0.5)
    assert length(line) == pytest.approx(2)
