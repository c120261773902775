"""The triangles of the signature surface: edge collapses keep the topology of the surface."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import cdist

from unbend import Surface, farthest_point_sampling, read_mesh
from unbend.geodesics.voronoi import geodesic_voronoi
from unbend.mesh.census import take_census
from unbend.mesh.shapes import bent_tube, cone, cylinder, sheet, sphere, torus
from unbend.signature.connectivity import signature_faces


def connect(surface: Surface, count: int) -> tuple[np.ndarray, np.ndarray]:
    samples = farthest_point_sampling(surface, min(count, len(surface.used_vertices)))
    return samples, connect_samples(surface, samples)


def connect_samples(surface: Surface, samples: np.ndarray) -> np.ndarray:
    nearest = geodesic_voronoi(surface, samples).nearest
    points = surface.vertices[samples]
    return signature_faces(surface, samples, nearest, cdist(points, points))


def topology(surface: Surface) -> dict[str, int]:
    """Return the Euler characteristic and the counts of `Census`, except the number of boundary edges."""
    used, edges = surface.used_vertices, surface.edges
    census = take_census(surface)
    return {
        "characteristic": len(used) - len(edges.starts) + len(surface.faces),
        "loops": census.boundary_loops,
        "nonmanifold_edges": census.nonmanifold_edges,
        "nonmanifold_vertices": census.nonmanifold_vertices,
        "misoriented_edges": census.misoriented_edges,
    }


def moebius(columns: int = 60, rows: int = 8) -> Surface:
    """Return a Moebius strip, whose faces have opposite orientations along one line."""
    turn, across = np.meshgrid(np.arange(columns) * 2 * np.pi / columns, np.linspace(-0.4, 0.4, rows), indexing="ij")
    radius = 1 + across * np.cos(turn / 2)
    vertices = np.stack([radius * np.cos(turn), radius * np.sin(turn), across * np.sin(turn / 2)], axis=-1)
    grid = np.arange(columns * rows).reshape(columns, rows)
    grid = np.vstack([grid, grid[:1, ::-1]])
    a, b, c, d = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    return Surface(vertices.reshape(-1, 3), faces)


SURFACES = {
    "sphere": sphere(subdivisions=4),
    "torus": torus(columns=60, rows=30),
    "sheet": sheet(columns=40, rows=20),
    "cylinder": cylinder(columns=40, rows=20),
    "cone": cone(),
    "tube": bent_tube(),
}


@pytest.mark.parametrize("count", [60, 150, 300])
@pytest.mark.parametrize("name", SURFACES)
def test_the_triangles_keep_the_topology_and_every_sample(name, count):
    surface = SURFACES[name]
    samples, faces = connect(surface, count)
    assert topology(Surface(surface.vertices[samples], faces)) == topology(surface)
    assert set(faces.ravel().tolist()) == set(range(len(samples)))


def test_the_triangles_of_a_moebius_strip_form_a_moebius_strip():
    surface = moebius()
    samples, faces = connect(surface, 60)
    reduced, whole = topology(Surface(surface.vertices[samples], faces)), topology(surface)
    assert whole["misoriented_edges"] > 0
    for name in ("characteristic", "loops", "nonmanifold_edges", "nonmanifold_vertices"):
        assert reduced[name] == whole[name], name
    assert reduced["misoriented_edges"] > 0


def test_triangles_have_the_orientation_of_the_surface():
    surface = sphere(subdivisions=4)
    samples, faces = connect(surface, 100)
    a, b, c = surface.vertices[samples][faces].transpose(1, 0, 2)
    a0, b0, c0 = surface.vertices[surface.faces].transpose(1, 0, 2)
    outwards = np.sign((np.cross(b0 - a0, c0 - a0) * a0).sum(axis=1))
    assert len(set(outwards.tolist())) == 1
    assert (np.sign((np.cross(b - a, c - a) * a).sum(axis=1)) == outwards[0]).all()


@pytest.mark.parametrize("name", SURFACES)
def test_the_triangles_are_the_faces_if_every_vertex_is_a_sample(name):
    surface = SURFACES[name]
    samples = np.random.default_rng(0).permutation(surface.used_vertices)
    np.testing.assert_array_equal(samples[connect_samples(surface, samples)], surface.faces)


def test_triangles_of_dense_samples_are_the_dual_of_the_voronoi_diagram():
    surface = sphere(subdivisions=5)
    samples, faces = connect(surface, 200)
    cells = geodesic_voronoi(surface, samples).nearest[surface.faces]
    dual = {tuple(sorted(cell)) for cell in cells.tolist() if len(set(cell)) == 3}
    assert {tuple(sorted(face)) for face in faces.tolist()} == dual


def test_triangles_are_nearly_regular():
    surface = torus(columns=90, rows=45)
    samples, faces = connect(surface, 300)
    sides = np.linalg.norm(np.diff(surface.vertices[samples][faces[:, [0, 1, 2, 0]]], axis=1), axis=-1)
    half = sides.sum(axis=1) / 2
    areas = np.sqrt(half * (half[:, None] - sides).prod(axis=1))
    quality = 4 * np.sqrt(3) * areas / (sides**2).sum(axis=1)  # 1 for a regular triangle
    assert quality.mean() > 0.85
    assert np.percentile(quality, 5) > 0.6


def test_four_samples_of_a_torus_give_valid_triangles():
    surface = torus(columns=60, rows=30)
    samples, faces = connect(surface, 4)
    assert len(faces) > 0
    assert well_formed(faces, len(samples))


def test_triangles_are_the_same_in_every_run():
    surface = torus(columns=60, rows=30)
    np.testing.assert_array_equal(connect(surface, 80)[1], connect(surface, 80)[1])


def soup(seed: int, vertices: int, faces: int) -> Surface:
    rng = np.random.default_rng(seed)
    return Surface(rng.normal(size=(vertices, 3)), rng.integers(0, vertices, (faces, 3)))


def well_formed(faces: np.ndarray, count: int) -> bool:
    """Check that each triangle has three different samples, and that no triangle occurs twice."""
    rows = np.sort(faces, axis=1)
    return bool(
        faces.dtype == np.int32
        and ((faces >= 0) & (faces < count)).all()
        and (np.diff(rows, axis=1) > 0).all()
        and len(np.unique(rows, axis=0)) == len(rows)
    )


@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1), st.integers(3, 40), st.integers(1, 120), st.integers(1, 40))
def test_any_triangle_soup_gives_valid_triangles(seed, vertices, faces, count):
    surface = soup(seed, vertices, faces)
    samples, found = connect(surface, count)
    assert well_formed(found, len(samples))
    if len(samples) == len(surface.used_vertices):
        proper = {tuple(sorted(face)) for face in surface.faces.tolist() if len(set(face)) == 3}
        assert {tuple(sorted(face)) for face in samples[found].tolist()} == proper


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1), st.integers(20, 120))
def test_duplicate_and_degenerate_faces_do_not_change_the_triangles(seed, count):
    surface, rng = torus(columns=30, rows=15), np.random.default_rng(seed)
    again = surface.faces[rng.integers(0, len(surface.faces), 9)][:, [1, 0, 2]]
    points = np.repeat(surface.faces[:5, :1], 3, axis=1)
    other = Surface(surface.vertices, np.vstack([surface.faces, again, points]))
    samples = farthest_point_sampling(surface, count)
    nearest = geodesic_voronoi(surface, samples).nearest
    distances = cdist(surface.vertices[samples], surface.vertices[samples])
    np.testing.assert_array_equal(
        signature_faces(other, samples, nearest, distances), signature_faces(surface, samples, nearest, distances)
    )


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1), st.integers(40, 120))
def test_the_topology_is_kept_for_any_orientation_of_faces(seed, count):
    surface = torus(columns=30, rows=15)
    flipped = np.random.default_rng(seed).random(len(surface.faces)) < 0.3
    other = Surface(surface.vertices, np.where(flipped[:, None], surface.faces[:, ::-1], surface.faces))
    samples, faces = connect(other, count)
    reduced, whole = topology(Surface(other.vertices[samples], faces)), topology(other)
    del reduced["misoriented_edges"], whole["misoriented_edges"]
    assert reduced == whole


@pytest.mark.parametrize("tops", [1, 2])
def test_sheets_with_a_common_line_keep_that_line(tops):
    """Sheets share a line; after all collapses, each edge has one face, two, or as many as there are sheets."""
    grid = sheet(columns=20, rows=10)
    rows = grid.vertices[:, 1]
    seam = np.flatnonzero(rows == rows.min())
    pages, number = [], np.full(len(grid.vertices), -1)
    vertices = [grid.vertices]
    for page in range(1, tops + 2):
        number = np.arange(len(grid.vertices)) + page * len(grid.vertices)
        number[seam] = seam
        angle = page * 2 * np.pi / (tops + 2)
        y = rows - rows.min()
        vertices.append(np.column_stack([grid.vertices[:, 0], rows.min() + y * np.cos(angle), y * np.sin(angle)]))
        pages.append(number[grid.faces])
    surface = Surface(np.vstack(vertices), np.vstack([grid.faces, *pages]))
    samples, faces = connect(surface, 120)
    reduced, whole = topology(Surface(surface.vertices[samples], faces)), topology(surface)
    assert reduced["characteristic"] == whole["characteristic"]
    edges = Surface(surface.vertices[samples], faces).edges
    assert set(edges.counts.tolist()) == {1, 2, tops + 2}


def test_a_vertex_and_an_edge_with_many_faces_take_less_than_quadratic_time():
    size = 20_000  # an algorithm of quadratic time would take minutes
    turn = np.arange(size)
    rim = np.column_stack([np.cos(turn * 2 * np.pi / size), np.sin(turn * 2 * np.pi / size), np.zeros(size)])
    fan = Surface(np.vstack([[0, 0, 0.5], rim]), np.column_stack([0 * turn, 1 + turn, 1 + (turn + 1) % size]))
    book = Surface(np.vstack([[0, 0, -1], [0, 0, 1], rim]), np.column_stack([0 * turn, 0 * turn + 1, 2 + turn]))
    for surface in (fan, book):
        samples = np.arange(2, 52)
        nearest = (np.arange(len(surface.vertices)) % 50).astype(np.int32)
        assert well_formed(signature_faces(surface, samples, nearest, np.ones((50, 50))), 50)


@pytest.mark.parametrize("dataset", ["tosca5k", "faust5k"])
def test_the_triangles_of_real_meshes_keep_the_topology(labelled, dataset):
    for path, _ in labelled(dataset)[::10]:
        surface = read_mesh(path)
        for count in (100, 300):
            samples, faces = connect(surface, count)
            assert topology(Surface(surface.vertices[samples], faces)) == topology(surface), (path, count)
