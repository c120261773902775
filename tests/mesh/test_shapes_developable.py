"""Sheets, cones and the helicoid family: bending keeps connectivity, lengths and area."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from unbend.errors import ParameterError
from unbend.mesh.shapes import bend, cone, cylinder, helicoid_catenoid, s_bend, sheet, spiral

BENT = [
    pytest.param(cylinder, id="cylinder"),
    pytest.param(s_bend, id="s_bend"),
    pytest.param(spiral, id="spiral"),
    pytest.param(lambda **grid: cylinder(0.99 * 2 * math.pi, **grid), id="nearly closed cylinder"),
    pytest.param(lambda **grid: spiral(3.0, 0.03, **grid), id="tight spiral"),
]


def edge_lengths(surface):
    corners = surface.vertices[surface.faces]
    return np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)


def largest_stretch(flat, bent):
    """Return the largest relative difference of edge lengths."""
    return float(np.max(np.abs(edge_lengths(bent) / edge_lengths(flat) - 1)))


def assert_second_order(errors):
    """Check that errors decrease with the square of the cell size, which is halved from each error to the next."""
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert (orders > 1.8).all(), (errors, orders)


@pytest.mark.parametrize("make", BENT)
@pytest.mark.parametrize("shape", [{}, {"shear": 0.7, "triangulation": "uniform"}], ids=["straight", "sheared"])
def test_bent_sheets_are_isometric_to_second_order(make, shape):
    errors = []
    for refinement in (1, 2, 4):
        grid = shape | {"columns": 60 * refinement, "rows": 8 * refinement}
        errors.append(largest_stretch(sheet(**grid), make(**grid)))
    assert errors[0] < 0.03
    assert_second_order(errors)


@pytest.mark.parametrize("make", [cylinder, s_bend, spiral])
def test_bent_sheets_share_faces_and_never_exceed_the_flat_area(make):
    bent = make()
    assert np.array_equal(bent.faces, sheet().faces)
    assert bent.area == pytest.approx(2.0, rel=0.01)
    assert bent.area < 2.0


@pytest.mark.parametrize("triangulation", ["alternating", "uniform"])
@pytest.mark.parametrize("shear", [-0.5, 0.0, 1.5])
def test_a_sheet_has_the_given_size_and_faces_up(triangulation, shear):
    flat = sheet(3.0, 0.5, columns=7, rows=5, triangulation=triangulation, shear=shear)
    assert flat.vertices.shape == (48, 3)
    assert flat.faces.shape == (70, 3)
    assert flat.area == pytest.approx(1.5)
    a, b, c = (flat.vertices[flat.faces[:, k]] for k in range(3))
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()


def test_the_layers_of_a_spiral_keep_their_gap():
    turns, gap = 2.0, 0.05
    rolled = spiral(turns, gap, columns=2000, rows=1)
    x, z = rolled.vertices[:2001, 0], rolled.vertices[:2001, 2]
    radius, angle = np.hypot(x, z), np.unwrap(np.arctan2(z, x))
    assert angle[-1] - angle[0] == pytest.approx(2 * math.pi * turns, abs=1e-9)
    inner = angle < angle[0] + 2 * math.pi * (turns - 1)
    layer_above = np.interp(angle[inner] + 2 * math.pi, angle, radius)
    assert layer_above - radius[inner] == pytest.approx(gap, abs=1e-6)


@settings(max_examples=30, deadline=None)
@given(angle=st.floats(0.01, 6.2), shear=st.floats(-1, 1), height=st.floats(0.1, 5))
def test_edges_of_a_cylinder_are_slightly_shorter_than_those_of_the_sheet(angle, shear, height):
    flat = sheet(height=height, shear=shear)
    bent = cylinder(angle, height=height, shear=shear)
    assert (edge_lengths(bent) <= edge_lengths(flat) * (1 + 1e-12)).all()
    # A chord over the angle a is shorter than its arc by at most a^2 / 24 of the arc.
    step = (2 / 40 + abs(shear) * height / 20) / (2 + abs(shear) * height)
    assert largest_stretch(flat, bent) <= (angle * step) ** 2 / 24 + 1e-12


def test_bend_accepts_any_flat_surface():
    flat = cone(roll=0.0)
    half_pipe = bend(flat, lambda s: (np.sin(s), 1 - np.cos(s)))
    assert half_pipe.area == pytest.approx(flat.area, rel=2e-3)


def test_rolled_cones_are_isometric_to_second_order():
    for inner in (0.0, 0.3):
        for roll in (0.4, 1.0):
            errors = []
            for refinement in (1, 2, 4):
                grid = {"inner": inner, "rings": 8 * refinement, "segments": 24 * refinement}
                flat, rolled = cone(roll=0.0, **grid), cone(roll=roll, **grid)
                assert np.array_equal(flat.faces, rolled.faces)
                errors.append(largest_stretch(flat, rolled))
            assert_second_order(errors)


@pytest.mark.parametrize("inner", [0.0, 0.2])
@pytest.mark.parametrize("roll", [0.0, 0.5, 1.0])
def test_a_cone_has_the_known_area_and_slant(inner, roll):
    rolled = cone(2.5, roll, inner=inner)
    assert rolled.area == pytest.approx(2.5 * (1 - inner**2) / 2, rel=2e-3)
    slant = np.linalg.norm(rolled.vertices, axis=1)
    assert slant.max() == pytest.approx(1.0)
    assert slant.min() == pytest.approx(inner)
    assert rolled.face_areas.min() > 0
    assert np.unique(rolled.faces).size == len(rolled.vertices)


def test_the_edges_of_a_fully_rolled_cone_nearly_meet():
    rolled = cone(roll=1.0, rings=1, segments=50)
    first, last = rolled.vertices[51], rolled.vertices[-1]
    assert 0 < np.linalg.norm(first - last) < 0.1


@pytest.mark.parametrize("t", [0.3, 0.9, math.pi / 2])
def test_the_helicoid_family_is_isometric_to_second_order(t):
    errors = []
    for refinement in (1, 2, 4):
        grid = {"columns": 40 * refinement, "rows": 16 * refinement}
        helicoid, other = helicoid_catenoid(0.0, **grid), helicoid_catenoid(t, **grid)
        assert np.array_equal(helicoid.faces, other.faces)
        errors.append(largest_stretch(helicoid, other))
    assert_second_order(errors)


@pytest.mark.parametrize("t", [-1.0, 0.0, 0.7, math.pi / 2])
def test_the_helicoid_family_has_the_known_area(t):
    span, reach = 5.0, 1.2
    surface = helicoid_catenoid(t, columns=120, rows=60, span=span, reach=reach)
    assert surface.area == pytest.approx(span * (reach + math.sinh(2 * reach) / 2), rel=1e-3)


@pytest.mark.parametrize(
    "make",
    [
        lambda: sheet(0.0),
        lambda: sheet(height=float("nan")),
        lambda: sheet(columns=0),
        lambda: sheet(rows=2.5),
        lambda: sheet(columns=float("nan")),
        lambda: sheet(columns=float("inf")),
        lambda: sheet(triangulation="random"),
        lambda: sheet(shear=float("inf")),
        lambda: cylinder(0.0),
        lambda: cylinder(2 * math.pi),
        lambda: s_bend(7.0),
        lambda: spiral(0.0),
        lambda: spiral(gap=-0.1),
        lambda: spiral(5.0, 0.5),
        lambda: cone(0.0),
        lambda: cone(roll=1.1),
        lambda: cone(inner=1.0),
        lambda: cone(rings=0),
        lambda: helicoid_catenoid(2.0),
        lambda: helicoid_catenoid(span=2 * math.pi),
        lambda: helicoid_catenoid(reach=0.0),
    ],
)
def test_invalid_parameters_of_developable_shapes_are_refused(make):
    with pytest.raises(ParameterError):
        make()
