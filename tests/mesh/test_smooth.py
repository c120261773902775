"""Smoothing: it removes noise, and keeps the shape and the indices."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.defects import defective
from unbend import MeshPolicy, Surface, geodesic_distances, read_mesh
from unbend.errors import MeshError, MeshGeometryError
from unbend.mesh.repair import repair
from unbend.mesh.shapes import bent_tube, cylinder, sheet, sphere, tetrahedron, torus
from unbend.mesh.write import write_mesh

SHRINK, SWELL = 0.5, -0.53
BASES = [
    sphere(2),
    torus(columns=12, rows=8),
    sheet(columns=6, rows=5),
    cylinder(columns=8, rows=5),
    bent_tube("helix", around=8),
]


def smoothed(vertices, faces, rounds, **policy):
    return repair(vertices, faces, policy=MeshPolicy(smooth=rounds, **policy))


def noisy(surface, share, seed=0):
    """Return the vertices with Gaussian noise whose deviation is a share of the bounding box's diagonal."""
    deviation = share * np.linalg.norm(np.ptp(surface.vertices, axis=0))
    return surface.vertices + deviation * np.random.default_rng(seed).normal(size=surface.vertices.shape)


def plain_round(vertices, faces):
    """Compute Taubin's round vertex by vertex; boundary vertices use only their neighbours on the boundary."""
    sides = [frozenset(side) for a, b, c in faces.tolist() for side in ((a, b), (b, c), (c, a))]
    rim = {side for side in sides if sides.count(side) == 1}
    on_rim = set().union(*rim)
    near = [
        [next(iter(side - {vertex})) for side in (rim if vertex in on_rim else set(sides)) if vertex in side]
        for vertex in range(len(vertices))
    ]
    for share in (SHRINK, SWELL):
        means = [vertices[some].mean(axis=0) if some else vertices[own] for own, some in enumerate(near)]
        vertices = vertices + share * (np.array(means) - vertices)
    return vertices


@given(st.integers(0, 2**32 - 1), st.sampled_from(range(len(BASES))), st.integers(1, 3))
@settings(max_examples=15)
def test_smoothing_equals_a_plain_implementation_of_taubin(seed, base, rounds):
    generator, surface = np.random.default_rng(seed), BASES[base]
    faces = surface.faces[generator.random(len(surface.faces)) < 0.95]
    vertices = surface.vertices + 0.05 * generator.normal(size=surface.vertices.shape)
    expected = vertices
    for _ in range(rounds):
        expected = plain_round(expected, faces)
    found = smoothed(vertices, faces, rounds, components="bridge").vertices
    np.testing.assert_allclose(found, expected, atol=1e-12)


@pytest.mark.parametrize(
    ("surface", "frequency"),
    # With the centre at 0, the mean of a vertex's neighbours is the vertex times 1 - frequency.
    [(tetrahedron(), 4 / 3), (sphere(0), 1 - 1 / np.sqrt(5))],
    ids=["tetrahedron", "icosahedron"],
)
def test_a_regular_solid_is_scaled_by_the_gain_at_its_frequency(surface, frequency):
    centre = surface.vertices.mean(axis=0)
    gain = ((1 - SHRINK * frequency) * (1 - SWELL * frequency)) ** 4
    found = smoothed(surface.vertices, surface.faces, 4)
    np.testing.assert_allclose(found.vertices - centre, gain * (surface.vertices - centre), atol=1e-12)
    assert found.report.area_change == pytest.approx(gain**2 - 1)
    assert found.report.smoothing_rounds == 4
    assert any(f"smoothed in 4 rounds: the area changed by {gain**2 - 1:+.2%}" in note for note in found.report.notes)


@pytest.mark.parametrize("share", [0.003, 0.01])
def test_smoothing_restores_the_form_and_the_size_of_a_noisy_sphere(share):
    ball = sphere(4)
    vertices = noisy(ball, share)
    found = smoothed(vertices, ball.faces, 30)
    before, after = (np.linalg.norm(places, axis=1) for places in (vertices, found.vertices))
    assert after.std() < before.std() / 3  # the remaining noise has frequencies as low as those of the shape
    assert after.mean() == pytest.approx(1, abs=0.01)
    rough = Surface(vertices, ball.faces)
    assert found.area == pytest.approx(ball.area, rel=0.02)
    assert found.report.area_change == pytest.approx(found.area / rough.area - 1)
    exact = np.arccos(np.clip(ball.vertices @ ball.vertices[0], -1, 1))[1:]
    errors = [abs(geodesic_distances(surface, 0)[0][1:] / exact - 1).mean() for surface in (rough, found)]
    assert errors[1] < 0.02
    assert errors[1] < errors[0] / 2


@pytest.mark.parametrize("surface", BASES[:3], ids=["ball", "ring", "sheet"])
def test_smoothing_hardly_moves_a_clean_surface(surface):
    found = smoothed(surface.vertices, surface.faces, 2)
    moved = np.linalg.norm(found.vertices - surface.vertices, axis=1).max()
    assert 0 < moved < 0.05 * surface.extent
    assert abs(found.report.area_change) < 0.05


def test_zero_rounds_change_nothing():
    ball = sphere(2)
    found = smoothed(ball.vertices, ball.faces, 0)
    np.testing.assert_array_equal(found.vertices, ball.vertices)
    assert (found.report.smoothing_rounds, found.report.area_change) == (0, None)
    assert not any("smooth" in note for note in found.report.notes)


def test_a_boundary_is_smoothed_independently_of_the_interior():
    flat = sheet(columns=8, rows=6)
    sides = (flat.vertices == flat.vertices.min(axis=0)) | (flat.vertices == flat.vertices.max(axis=0))
    rim, corners = sides[:, :2].any(axis=1), flat.vertices[sides[:, :2].all(axis=1)]
    bumpy = flat.vertices + np.where(rim, 0, np.random.default_rng(0).normal(size=len(rim)))[:, None] * [0, 0, 1]
    even, uneven = (smoothed(vertices, flat.faces, 10).vertices for vertices in (flat.vertices, bumpy))
    np.testing.assert_array_equal(even[rim], uneven[rim])
    assert abs(uneven[~rim] - even[~rim]).max() > 0.01
    # A boundary vertex midway between its neighbours stays, unless a corner is at most two edges away: a round has two
    # steps, and each step uses the neighbours.
    to_corner = np.linalg.norm(flat.vertices[:, None] - corners, axis=2).min(axis=1)
    edge = np.unique(to_corner[rim].round(9))[1:3].max()
    once = smoothed(flat.vertices, flat.faces, 1).vertices
    between = rim & (to_corner > 2.5 * edge)
    assert between.sum() >= 4
    np.testing.assert_allclose(once[between], flat.vertices[between], atol=1e-12)
    assert abs(once - flat.vertices)[rim & ~between].max() > 1e-3


def test_smoothing_changes_neither_unused_vertices_nor_faces():
    ball = sphere(2)
    alone = np.array([[5.0, 6, 7], [np.nan, 1, np.inf], [-np.inf, 0, 0]])
    vertices = np.concatenate([alone[:1], ball.vertices, alone[1:]])
    found = smoothed(vertices, ball.faces + 1, 5)
    np.testing.assert_array_equal(found.vertices[[0, -2, -1]], alone)
    np.testing.assert_array_equal(found.faces, ball.faces + 1)
    np.testing.assert_allclose(found.vertices[1:-2], smoothed(ball.vertices, ball.faces, 5).vertices, atol=1e-12)


def test_smoothing_does_not_depend_on_position_or_scale():
    ball = sphere(2)
    vertices = noisy(ball, 0.02)
    here = smoothed(vertices, ball.faces, 10).vertices
    for scale, offset in ((2.0**-300, 0.0), (2.0**300, 0.0), (1.0, 2.0**20)):
        there = smoothed(scale * vertices + offset, ball.faces, 10).vertices
        np.testing.assert_allclose((there - offset) / scale, here, atol=1e-9)


@given(defective(), st.sampled_from(["largest", "bridge"]), st.integers(1, 100))
def test_smoothing_a_damaged_mesh_gives_finite_vertices_or_a_typed_error(mesh, components, rounds):
    try:
        surface = smoothed(mesh.vertices, mesh.faces, rounds, components=components)
    except MeshError:
        return
    where = np.arange(len(mesh.vertices)) if surface.vertex_map is None else surface.vertex_map
    used = surface.used_vertices
    assert np.isfinite(surface.vertices[used]).all()
    unused = ~np.isin(where, used)
    np.testing.assert_array_equal(surface.vertices[where[unused]], mesh.vertices[unused])
    assert surface.area > 0
    assert np.isfinite(surface.report.area_change)


def test_a_mesh_that_smoothing_shrinks_to_a_point_is_refused():
    solid = tetrahedron()
    with pytest.raises(MeshGeometryError, match=r"after 100 rounds of smoothing no area is left: .* too few vertices"):
        smoothed(solid.vertices, solid.faces, 100)


def test_components_are_linked_after_smoothing():
    ball = sphere(2)
    vertices = np.concatenate([noisy(ball, 0.02), noisy(ball, 0.02, seed=1) + np.array([4, 0, 0])])
    faces = np.concatenate([ball.faces, ball.faces + len(ball.vertices)])
    found = smoothed(vertices, faces, 10, components="bridge")
    halves = [smoothed(half, ball.faces, 10).vertices for half in np.split(vertices, 2)]
    np.testing.assert_allclose(found.vertices, np.concatenate(halves), atol=1e-12)
    shortest = np.linalg.norm(halves[0][:, None] - halves[1], axis=2).min()
    assert found.report.longest_link == pytest.approx(shortest)


def test_a_mesh_is_smoothed_before_it_is_simplified():
    ball = sphere(3)
    vertices = noisy(ball, 0.01)
    both = smoothed(vertices, ball.faces, 10, max_vertices=200)
    after = repair(smoothed(vertices, ball.faces, 10).vertices, ball.faces, policy=MeshPolicy(max_vertices=200))
    np.testing.assert_array_equal(both.vertices, after.vertices)
    np.testing.assert_array_equal(both.vertex_map, after.vertex_map)
    assert both.report.deviation == after.report.deviation
    words = " ".join(both.report.notes)
    assert words.index("smoothed in") < words.index("simplified from")


def test_a_file_is_smoothed_by_its_policy():
    ball = sphere(2)
    data = write_mesh(noisy(ball, 0.01), ball.faces, "ply")
    plain = read_mesh(data)
    found = read_mesh(data, policy=MeshPolicy(smooth=3))
    np.testing.assert_array_equal(found.vertices, smoothed(plain.vertices, plain.faces, 3).vertices)
