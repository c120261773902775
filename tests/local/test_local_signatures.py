"""Local signatures of surfaces whose geodesic circles are known."""

from __future__ import annotations

import numpy as np
import pytest

from unbend import Surface
from unbend.errors import MeshGeometryError, ParameterError
from unbend.library.packing import pack_local, unpack_local
from unbend.local.key_points import curvature, key_points
from unbend.local.signatures import enlarged, local_signatures
from unbend.mesh.shapes import cylinder, ellipsoid, sphere

PLAIN = ("places", "growth", "reach", "distances")


def square(side: int = 65, bend: float = 0.0) -> Surface:
    """A unit square, flat or rolled to a part of a tube."""
    u, v = np.meshgrid(np.linspace(0, 1, side), np.linspace(0, 1, side), indexing="ij")
    x, z = (np.sin(bend * u) / bend, np.cos(bend * u) / bend) if bend else (u, 0 * u)
    corner = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
    faces = np.concatenate(
        [np.stack([corner, corner + side, corner + 1], 1), np.stack([corner + 1, corner + side, corner + side + 1], 1)]
    )
    return Surface(np.stack([x.ravel(), v.ravel(), z.ravel()], 1), faces)


def test_circles_of_a_sphere_have_the_areas_of_caps():
    local = local_signatures(sphere(4, radius=3.0))
    angle = np.minimum(local.radii / 3.0, np.pi)
    caps = 2 * np.pi * 9.0 * (1 - np.cos(angle)) / local.radii**2
    np.testing.assert_allclose(local.growth / caps, 1.0, atol=0.006)
    assert not local.is_open
    assert local.radii[0] == pytest.approx(2**-4.25 * np.sqrt(36 * np.pi), rel=0.1)


@pytest.mark.parametrize("bend", [0.0, 2.0])
def test_circles_in_a_flat_sheet_have_the_area_of_discs_until_they_reach_its_edge_also_if_it_is_rolled(bend):
    local = local_signatures(square(bend=bend))
    inside = local.reach[:, None] >= local.radii
    assert inside.sum() > 300
    np.testing.assert_allclose(local.growth[inside], np.pi, rtol=0.02)
    x = np.arctan2(local.places[:, 0], local.places[:, 2]) / bend if bend else local.places[:, 0]
    y = local.places[:, 1]
    np.testing.assert_allclose(local.reach, np.minimum.reduce([x, y, 1 - x, 1 - y]), atol=2e-3)


def test_radii_are_absolute_so_that_a_larger_surface_has_the_same_circles_some_rungs_higher():
    small, large = local_signatures(sphere(3)), local_signatures(sphere(3, radius=2.0))
    assert large.first == small.first + 4
    np.testing.assert_allclose(large.growth, small.growth, atol=1e-4)
    np.testing.assert_allclose(large.distances, 2 * small.distances, atol=1e-4)


@pytest.mark.parametrize("rungs", [0.25, 0.5])
def test_parts_of_a_rung_are_interpolated(rungs):
    surface = cylinder(4.0)
    between, factor = enlarged(local_signatures(surface), rungs), 2.0 ** (rungs / 4)
    made = local_signatures(Surface(surface.vertices * factor, surface.faces))
    assert between.area == pytest.approx(made.area)
    shift = between.first - made.first
    common = slice(max(0, -shift), min(between.growth.shape[1], made.growth.shape[1] - shift))
    expected = made.growth[:, common.start + shift : common.stop + shift]
    np.testing.assert_allclose(between.growth[:, common], expected, rtol=0.03)
    np.testing.assert_allclose(between.reach, made.reach, rtol=1e-3)


def test_coarse_surfaces_are_refined_so_that_their_circles_are_accurate():
    coarse = Surface(np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float), np.array([[0, 1, 2], [0, 2, 3]]))
    local = local_signatures(coarse)
    assert len(local) == 300
    inside = local.reach[:, None] >= local.radii
    np.testing.assert_allclose(local.growth[inside], np.pi, rtol=0.02)


def test_packing_keeps_everything_and_is_compact():
    local = local_signatures(square())
    packed = pack_local(local)
    found = unpack_local(packed)
    for name in PLAIN:
        np.testing.assert_allclose(getattr(found, name), getattr(local, name), rtol=1e-6, err_msg=name)
    assert (found.first, found.area, found.version) == (local.first, local.area, local.version)
    assert len(packed) < 90_000


def test_the_result_does_not_depend_on_the_number_of_threads():
    one, two = (local_signatures(square(), threads=threads) for threads in (1, 2))
    for name in PLAIN:
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name), name)


def test_surfaces_without_area_in_parts_or_without_centres_are_refused():
    with pytest.raises(MeshGeometryError, match="zero area"):
        local_signatures(Surface(np.zeros((3, 3)), np.array([[0, 1, 2]])))
    ball = sphere(2)
    apart = Surface(
        np.concatenate([ball.vertices, ball.vertices + 5]),
        np.concatenate([ball.faces, ball.faces + len(ball.vertices)]),
    )
    with pytest.raises(MeshGeometryError, match="not connected"):
        local_signatures(apart)
    with pytest.raises(ParameterError, match="count"):
        local_signatures(ball, centres=0)


def test_curvature_at_a_scale_is_that_of_a_sphere_and_unknown_at_the_boundary():
    np.testing.assert_allclose(curvature(local_signatures(sphere(4, radius=2.0))), 0.25, atol=0.02)
    flat = local_signatures(square())
    values = curvature(flat)
    assert np.isnan(values[flat.reach < 0.1]).all()
    assert np.nanmax(np.abs(values)) < 12 * 0.02 / 0.15**2


def test_key_points_of_an_egg_are_its_ends_first():
    egg = local_signatures(ellipsoid((3.0, 1.0, 1.0), subdivisions=4))
    first, second = egg.places[key_points(egg, 2)]
    assert sorted([round(float(first[0])), round(float(second[0]))]) == [-3, 3]
    with pytest.raises(ParameterError, match="count"):
        key_points(egg, 0)
