"""Spheres, tori and tubes are closed and oriented outward, with the correct topology and area."""

import math

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from unbend.errors import ParameterError
from unbend.mesh.shapes import (
    TUBE_POSES,
    SpaceCurve,
    bent_tube,
    ellipsoid,
    pin_profile,
    pose_curve,
    sphere,
    tetrahedron,
    torus,
    tube,
    worm_profile,
)


def assert_closed_and_oriented(surface, *, euler):
    """Check that every edge has a face on each side, that normals point outward, and that V - E + F is `euler`."""
    faces = surface.faces
    directed = np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)])
    unique = np.unique(directed, axis=0)
    assert len(unique) == len(directed)
    assert np.array_equal(unique, np.unique(directed[:, ::-1], axis=0))
    assert len(np.unique(faces)) == len(surface.vertices)
    assert len(surface.vertices) - len(directed) // 2 + len(faces) == euler
    assert volume(surface) > 0


def volume(surface):
    a, b, c = (surface.vertices[surface.faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


@pytest.mark.parametrize("subdivisions", [0, 1, 4])
def test_a_sphere_is_closed_with_the_given_radius(subdivisions):
    ball = sphere(subdivisions, radius=2.0)
    assert len(ball.vertices) == 10 * 4**subdivisions + 2
    assert np.linalg.norm(ball.vertices, axis=1) == pytest.approx(2.0)
    assert_closed_and_oriented(ball, euler=2)


def test_the_area_of_a_sphere_converges_at_second_order():
    errors = [4 * math.pi - sphere(level).area for level in (2, 3, 4)]
    assert np.log2(np.array(errors[:-1]) / errors[1:]) == pytest.approx(2.0, abs=0.1)


def test_an_ellipsoid_is_closed_with_the_given_axes():
    body = ellipsoid((3.0, 2.0, 1.0), subdivisions=4)
    assert_closed_and_oriented(body, euler=2)
    assert (body.vertices**2 / [9, 4, 1]).sum(axis=1) == pytest.approx(1.0)
    assert volume(body) == pytest.approx(4 / 3 * math.pi * 6, rel=0.01)


@pytest.mark.parametrize(("columns", "rows"), [(3, 3), (61, 24), (80, 31)])
def test_a_torus_is_closed_with_euler_characteristic_0(columns, rows):
    assert_closed_and_oriented(torus(columns=columns, rows=rows), euler=0)


def test_a_torus_has_the_known_area():
    assert torus(2.0, 0.5, columns=200, rows=80).area == pytest.approx(4 * math.pi**2, rel=2e-3)


def test_a_tetrahedron_is_closed_with_the_known_area_and_volume():
    solid = tetrahedron(2.0)
    assert_closed_and_oriented(solid, euler=2)
    assert solid.area == pytest.approx(math.sqrt(3) * 4)
    assert volume(solid) == pytest.approx(8 / (6 * math.sqrt(2)))


@pytest.mark.parametrize("pose", TUBE_POSES)
def test_pose_curves_have_unit_speed_and_the_given_length(pose):
    curve = pose_curve(pose, length=7.0)
    s = np.linspace(0.0, 7.0, 3001)
    assert curve.length == pytest.approx(7.0)
    steps = np.linalg.norm(np.diff(curve.points(s), axis=0), axis=1)
    assert steps / (7.0 / 3000) == pytest.approx(1.0, abs=1e-4)
    assert np.linalg.norm(curve.tangents(s), axis=1) == pytest.approx(1.0)


@pytest.mark.parametrize("pose", TUBE_POSES)
def test_every_pose_of_a_tube_is_closed_with_the_same_area_and_volume(pose):
    length, radius = 6.0, 0.15
    bent = bent_tube(pose, length=length, radius=radius, around=24)
    assert_closed_and_oriented(bent, euler=2)
    analytic = 2 * math.pi * radius * length + 4 * math.pi * radius**2  # Pappus
    assert bent.area == pytest.approx(analytic, rel=0.015)
    assert volume(bent) == pytest.approx(math.pi * radius**2 * length + 4 / 3 * math.pi * radius**3, rel=0.03)


@pytest.mark.parametrize("profile", [pin_profile(4.0, 0.26), worm_profile(4.0, 0.2)], ids=["pin", "worm"])
def test_profiled_tubes_keep_their_area(profile):
    poses = [bent_tube(pose, length=4.0, radius=profile) for pose in ("straight", "arc", "helix", "loop")]
    for pose in poses:
        assert_closed_and_oriented(pose, euler=2)
    areas = np.array([pose.area for pose in poses])
    assert np.ptp(areas) / areas.mean() < 0.01


def test_the_pin_profile_passes_through_its_knots_and_stays_between_them():
    radii = pin_profile(2.0, 1.0)(np.linspace(0.0, 2.0, 2001))
    assert radii[[0, 600, 1360, 2000]] == pytest.approx([0.7, 1.0, 0.35, 0.6])
    assert radii.min() == pytest.approx(0.35)
    assert radii.max() == pytest.approx(1.0)


def test_the_frame_of_a_tube_does_not_twist():
    # Along a plane curve, a rotation-minimising frame keeps its angle to the plane, so the height of each line of
    # vertices is constant.
    bent = bent_tube("arc", around=12, along=40)
    rings = bent.vertices[1 + 2 * 12 : -1 - 2 * 12].reshape(-1, 12, 3)
    assert np.ptp(rings[:, :, 2], axis=0) == pytest.approx(0.0, abs=1e-9)


def test_a_tube_can_follow_any_curve():
    angle = np.linspace(0.0, 1.5 * math.pi, 2000)
    curve = SpaceCurve.through(np.stack([2 * np.cos(angle), 2 * np.sin(angle), 0 * angle], axis=1))
    assert isinstance(curve.spline, CubicSpline)
    assert curve.length == pytest.approx(3 * math.pi, rel=1e-5)
    assert_closed_and_oriented(tube(curve, 0.5), euler=2)


@pytest.mark.parametrize(
    "make",
    [
        lambda: sphere(-1),
        lambda: sphere(9),
        lambda: sphere(radius=0.0),
        lambda: ellipsoid((1.0, 0.0, 1.0)),
        lambda: ellipsoid((1.0, 1.0)),
        lambda: torus(1.0, 1.0),
        lambda: torus(rows=2),
        lambda: tetrahedron(-1.0),
        lambda: bent_tube("pretzel"),
        lambda: bent_tube(length=0.0),
        lambda: bent_tube(radius=0.0),
        lambda: bent_tube(radius=lambda s: s - 1),
        lambda: bent_tube(around=4),
        lambda: bent_tube(along=1),
        lambda: bent_tube("knot", radius=0.3),
        lambda: bent_tube("helix", radius=1.0),
        lambda: pin_profile(radius=-1.0),
        lambda: worm_profile(segments=0),
        lambda: SpaceCurve.through(np.zeros((10, 3))),
        lambda: SpaceCurve.through(np.eye(3)),
    ],
)
def test_invalid_parameters_of_closed_shapes_are_refused(make):
    with pytest.raises(ParameterError):
        make()
