"""The intrinsic triangulation: it keeps the surface, and gives accurate distances on stretched meshes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings

from tests.support.defects import defective
from tests.support.oracles import exact_distances, grid, mean_relative_error
from tests.support.stretched_meshes import cad_models, height_map
from unbend import Surface, geodesic_distances, geodesic_matrix, read_mesh
from unbend.errors import MeshError
from unbend.geodesics.halfedges import HalfEdges, half_edges_of
from unbend.geodesics.intrinsic import intrinsic_triangulation
from unbend.geodesics.stencils import stencils_of
from unbend.mesh.repair import repair
from unbend.mesh.shapes import sphere, torus


def triangulated(surface: Surface) -> HalfEdges:
    return intrinsic_triangulation(half_edges_of(surface, surface.scale)).half_edges


def area_of(mesh: HalfEdges) -> float:
    a, b, c = mesh.lengths.reshape(-1, 3).T
    return float(np.sqrt(np.maximum((a + b + c) * (b + c - a) * (c + a - b) * (a + b - c), 0)).sum() / 4)


def angles_of(mesh: HalfEdges) -> np.ndarray:
    sides = mesh.lengths.reshape(-1, 3)
    a, b, c = sides, np.roll(sides, -1, axis=1), np.roll(sides, -2, axis=1)
    return np.arccos(np.clip((b**2 + c**2 - a**2) / (2 * b * c), -1, 1))


def angle_sums(mesh: HalfEdges) -> np.ndarray:
    return np.bincount(mesh.faces.ravel(), angles_of(mesh).ravel(), minlength=mesh.vertex_count)


def crumpled(seed: int, size: float = 0.3) -> Surface:
    ball = sphere(subdivisions=2)
    return Surface(ball.vertices + np.random.default_rng(seed).normal(0, size, ball.vertices.shape), ball.faces)


@pytest.mark.parametrize(
    "surface",
    [crumpled(1), crumpled(2), torus(columns=9, rows=6), grid(9, 7, 2.5), *cad_models().values(), height_map(30)],
)
def test_the_intrinsic_triangulation_keeps_area_angles_and_topology(surface):
    before, after = half_edges_of(surface, surface.scale), triangulated(surface)
    count = len(surface.vertices)
    assert area_of(after) == pytest.approx(area_of(before), rel=1e-9)
    sums = angle_sums(after)
    np.testing.assert_allclose(sums[:count], angle_sums(before), atol=1e-5)
    steiner = sums[count:]  # the surface is flat at Steiner points, inside or on a boundary
    assert (np.isclose(steiner, 2 * np.pi, atol=1e-5) | np.isclose(steiner, np.pi, atol=1e-5)).all()
    edges = (len(after.twins) + (after.twins < 0).sum()) / 2
    given_edges = (len(before.twins) + (before.twins < 0).sum()) / 2
    # the Euler characteristic
    assert after.vertex_count - edges + len(after.faces) == count - given_edges + len(before.faces)


@pytest.mark.parametrize("surface", [crumpled(3), grid(9, 7, 2.5), *cad_models().values(), height_map(100)])
def test_half_edges_are_consistent(surface):
    mesh = triangulated(surface)
    inner = np.flatnonzero(mesh.twins >= 0)
    np.testing.assert_array_equal(mesh.twins[mesh.twins[inner]], inner)
    np.testing.assert_allclose(mesh.lengths[mesh.twins[inner]], mesh.lengths[inner], rtol=1e-12)
    tail, head = (mesh.faces[np.arange(len(mesh.twins)) // 3, (np.arange(len(mesh.twins)) + k) % 3] for k in (1, 2))
    np.testing.assert_array_equal(tail[mesh.twins[inner]], head[inner])


@pytest.mark.parametrize("surface", [crumpled(4), grid(9, 7, 2.5), height_map(10)])
def test_every_edge_that_can_be_flipped_is_delaunay(surface):
    mesh = triangulated(surface)
    angles = angles_of(mesh).ravel()
    inner = np.flatnonzero(mesh.free)
    # An edge whose two faces have the same opposite vertex is not flipped: the new edge would be a loop.
    ends = mesh.faces.ravel()[inner] != mesh.faces.ravel()[mesh.twins[inner]]
    assert (angles[inner] + angles[mesh.twins[inner]] <= np.pi + 1e-4)[ends].all()


def test_good_triangles_are_not_changed():
    for surface in (sphere(subdivisions=3), grid(8, 8)):
        given_mesh = half_edges_of(surface, surface.scale)
        assert intrinsic_triangulation(given_mesh).half_edges is given_mesh


@given(defective())
@settings(max_examples=60)
def test_every_repaired_mesh_has_a_valid_intrinsic_triangulation(mesh):
    try:
        stencils = stencils_of(repair(mesh.vertices, mesh.faces))
    except MeshError:  # for example, edges too long for single precision
        return
    faces, twins, lengths = stencils.triangles[:3]
    sides = np.sort(lengths.reshape(-1, 3), axis=1)
    assert np.isfinite(sides).all()
    # A flip takes the square root of a difference of squares, so short edges inherit the rounding error of long ones.
    rounding = 64 * np.finfo(float).eps * lengths.max() ** 2 / sides[:, 2]
    assert (sides[:, 0] + sides[:, 1] >= sides[:, 2] * (1 - 1e-6) - rounding).all()
    assert (lengths[twins[twins >= 0]] == lengths[twins >= 0]).all()
    assert faces.max() < stencils.vertex_count


@pytest.mark.parametrize("surface", [sphere(subdivisions=1), *[cad_models()[name] for name in ("box", "plate")]])
def test_distances_on_surfaces_of_few_triangles_are_exact(surface):
    every = np.arange(len(surface.vertices))
    exact = exact_distances(surface, every)
    np.testing.assert_allclose(geodesic_distances(surface, every), exact, rtol=0.01, atol=1e-6 * surface.extent)


def test_distances_near_the_source_are_exact():
    surface = crumpled(5, 0.1)
    exact = exact_distances(surface, np.arange(4))
    near = exact < 0.5
    np.testing.assert_allclose(geodesic_distances(surface, np.arange(4))[near], exact[near], rtol=1e-4)


@pytest.mark.parametrize("slope", [1, 3, 10, 30, 100])
def test_distances_on_steep_height_maps_are_near_exact(slope):
    surface = height_map(slope)
    sources = np.linspace(0, len(surface.vertices) - 1, 8).astype(int)
    exact = exact_distances(surface, sources)
    assert mean_relative_error(geodesic_distances(surface, sources), exact) < 0.006
    assert mean_relative_error(geodesic_distances(surface, sources, update="planar"), exact) < 0.03


def test_the_height_map_that_once_had_half_the_distance_is_near_exact():
    surface = read_mesh(Path(__file__).parent / "cases" / "geo_steep_heightmap.obj")
    exact = exact_distances(surface, np.array([312]))
    assert mean_relative_error(geodesic_distances(surface, 312), exact) < 0.005


@pytest.mark.parametrize("name", list(cad_models()))
def test_distances_on_cad_models_are_near_exact(name):
    surface = cad_models()[name]
    sources = np.unique(np.linspace(0, len(surface.vertices) - 1, 8).astype(int))
    exact, distances = exact_distances(surface, sources), geodesic_distances(surface, sources)
    known = exact > 0
    errors = np.abs(distances[known] / exact[known] - 1)
    assert errors.mean() < 0.01
    assert errors.max() < 0.08


def test_distances_on_a_stretched_flat_sheet_are_near_straight_lines():
    surface = grid(40, 20)
    stretched = Surface(surface.vertices * [1, 50, 1], surface.faces)
    exact = np.linalg.norm(stretched.vertices - stretched.vertices[0], axis=1)
    assert mean_relative_error(geodesic_distances(stretched, 0)[0], exact) < 1e-3


def test_results_do_not_contain_steiner_points():
    surface = cad_models()["disc"]
    count = len(surface.vertices)
    assert triangulated(surface).vertex_count > count
    assert geodesic_distances(surface, [0, 5]).shape == (2, count)
    assert geodesic_matrix(surface, np.arange(count)).shape == (count, count)


@pytest.mark.parametrize("folder", ["tosca5k", "faust5k"])
def test_mean_and_largest_errors_on_real_meshes_are_bounded(shared_data, folder):
    largest, means = [], []
    for path in sorted((shared_data / folder).glob("*.off"))[::9]:
        surface = read_mesh(path)
        used, faces = np.unique(surface.faces, return_inverse=True)
        surface = Surface(surface.vertices[used], faces.reshape(-1, 3))
        sources = np.linspace(0, len(used) - 1, 4).astype(int)
        exact, distances = exact_distances(surface, sources), geodesic_distances(surface, sources)
        errors = np.abs(distances[exact > 0] / exact[exact > 0] - 1)
        largest.append(errors.max())
        means.append(errors.mean())
    assert np.mean(largest) < 0.035
    assert np.mean(means) < 0.0025
    assert np.max(means) < 0.0035
