"""Simplification: the number of vertices, the vertex map, and the reported deviation."""

from __future__ import annotations

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from unbend import MeshPolicy, Surface, geodesic_distances, read_mesh
from unbend.errors import MeshGeometryError
from unbend.mesh import deviation
from unbend.mesh.repair import repair
from unbend.mesh.shapes import bent_tube, sheet, sphere, torus

SHAPES = {
    "ball": sphere(3),
    "ring": torus(columns=40, rows=16),
    "sheet": sheet(columns=20, rows=15),
    "tube": bent_tube("helix", around=12),
}


def simplified(surface, most, components="largest"):
    policy = MeshPolicy(components=components, max_vertices=most)
    return repair(surface.vertices, surface.faces, policy=policy)


def largest_distance(points, surface):
    """Return the largest distance of the points from a surface, by comparing every point with every triangle."""
    scale = surface.extent  # the tolerances of trimesh assume meshes of about unit size
    triangles = surface.vertices[surface.faces] / scale
    distances = []
    for point in points / scale:
        nearest = trimesh.triangles.closest_point(triangles, np.broadcast_to(point, triangles[:, 0].shape))
        distances.append(np.linalg.norm(nearest - point, axis=1).min())
    return scale * max(distances)


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("most", [250, 60])
def test_a_simplified_surface_is_similar_and_has_at_most_the_given_vertices(name, most):
    whole = SHAPES[name]
    surface = simplified(whole, most)
    assert 0.9 * most < len(surface.vertices) <= most
    np.testing.assert_array_equal(surface.used_vertices, np.arange(len(surface.vertices)))
    assert surface.area == pytest.approx(whole.area, rel=0.1)
    assert surface.report.simplified_vertices == len(surface.vertices)
    assert (surface.report.vertices, surface.report.faces) == (len(whole.vertices), len(whole.faces))
    assert any("simplified" in note for note in surface.report.notes)


@given(st.sampled_from(sorted(SHAPES)), st.integers(4, 300), st.integers(0, 2**32 - 1))
@settings(max_examples=20)
def test_the_vertex_map_is_complete_and_the_deviation_is_exact(name, most, seed):
    generator = np.random.default_rng(seed)
    whole = SHAPES[name]
    order = generator.permutation(len(whole.vertices))  # the numbering must not matter
    vertices = np.empty_like(whole.vertices)
    vertices[order] = whole.vertices
    shuffled = Surface(generator.choice([1e-3, 1.0, 1e40]) * (vertices + 7), order[whole.faces])
    surface = simplified(shuffled, most)
    assert surface.vertex_map.shape == (len(vertices),)
    assert set(surface.vertex_map.tolist()) == set(range(len(surface.vertices)))  # every vertex is mapped
    report = surface.report
    assert report.deviation == pytest.approx(
        largest_distance(shuffled.vertices, surface), rel=1e-6, abs=1e-9 * surface.extent
    )
    assert report.relative_deviation == pytest.approx(report.deviation / np.sqrt(shuffled.area))


@given(st.integers(0, 2**32 - 1), st.sampled_from(["soup", "slivers", "ball"]))
@settings(max_examples=40)
def test_the_largest_distance_is_exact_for_any_initial_guess(seed, kind):
    generator = np.random.default_rng(seed)
    vertices, faces = generator.normal(size=(60, 3)), generator.integers(0, 60, (50, 3))
    if kind == "slivers":
        vertices[:, 1:] *= [1e-3, 0]
    elif kind == "ball":
        vertices, faces = sphere(2).vertices, sphere(2).faces
    points = generator.normal(size=(5, 3)) * generator.choice([0.1, 1, 10])
    near = generator.integers(-1, len(vertices), 5)
    near[~np.isin(near, faces)] = -1
    expected = largest_distance(points, Surface(vertices, faces))
    assert deviation.largest_distance(points, vertices, faces, near) == pytest.approx(expected, rel=1e-6)


def test_faces_of_zero_area_do_not_prevent_simplification():
    # A quarter of the faces are split at the midpoint of one side. A face without area joins the two halves of this
    # side to the whole side of the neighbour.
    flat = sheet(columns=20, rows=20)
    vertices, faces = flat.vertices.tolist(), []
    for number, (a, b, c) in enumerate(flat.faces.tolist()):
        middle = len(vertices)
        if number % 4:
            faces.append([a, b, c])
        else:
            vertices.append(((flat.vertices[a] + flat.vertices[b]) / 2).tolist())
            faces += [[a, middle, c], [middle, b, c], [a, b, middle]]
    surface = repair(vertices, faces, policy=MeshPolicy(max_vertices=80))
    assert surface.report.zero_area_faces == len(flat.faces) // 4
    assert len(surface.vertices) <= 80
    assert surface.area == pytest.approx(flat.area, rel=0.1)
    assert surface.report.relative_deviation < 0.1


def test_vertices_that_are_not_merged_are_not_moved():
    whole = SHAPES["ball"]
    surface = simplified(whole, 600)
    counts = np.bincount(surface.vertex_map)
    alone = np.flatnonzero(counts[surface.vertex_map] == 1)
    assert len(alone) > 400
    np.testing.assert_array_equal(surface.vertices[surface.vertex_map[alone]], whole.vertices[alone])


def test_mapped_vertices_have_nearly_the_distances_of_the_original():
    whole = SHAPES["tube"]
    surface = simplified(whole, len(whole.vertices) // 3)
    source = 0
    expected = geodesic_distances(whole, source)[0]
    actual = geodesic_distances(surface, int(surface.vertex_map[source]))[0][surface.vertex_map]
    assert np.abs(actual - expected).max() < 0.05 * expected.max()


def test_a_surface_that_is_small_enough_is_not_changed():
    whole = SHAPES["ball"]
    surface = simplified(whole, len(whole.vertices))
    np.testing.assert_array_equal(surface.vertices, whole.vertices)
    np.testing.assert_array_equal(surface.faces, whole.faces)
    assert surface.vertex_map is None
    assert surface.report.simplified_vertices is None


def test_unused_vertices_do_not_count_and_are_not_mapped():
    ball = sphere(2)
    vertices = np.concatenate([[[np.nan] * 3], ball.vertices, [[9, 9, 9]]])
    policy = MeshPolicy(max_vertices=len(ball.vertices))
    assert repair(vertices, ball.faces + 1, policy=policy).vertex_map is None
    surface = repair(vertices, ball.faces + 1, policy=MeshPolicy(max_vertices=50))
    assert np.flatnonzero(surface.vertex_map < 0).tolist() == [0, len(vertices) - 1]
    assert np.isfinite(surface.vertices).all()


def test_vertices_of_dropped_components_are_not_mapped():
    ball, small = sphere(2), sphere(0, radius=0.1)
    vertices = np.concatenate([small.vertices + 5, ball.vertices])
    faces = np.concatenate([small.faces, ball.faces + len(small.vertices)])
    surface = repair(vertices, faces, policy=MeshPolicy(max_vertices=50))
    np.testing.assert_array_equal(np.flatnonzero(surface.vertex_map < 0), np.arange(len(small.vertices)))


def test_components_are_linked_after_simplification():
    ball = sphere(3)
    vertices = np.concatenate([ball.vertices, ball.vertices + np.array([4, 0, 0])])
    faces = np.concatenate([ball.faces, ball.faces + len(ball.vertices)])
    surface = repair(vertices, faces, policy=MeshPolicy(components="bridge", max_vertices=200))
    assert surface.report.links == 1
    assert surface.report.longest_link == pytest.approx(2.0, rel=0.05)
    assert len(surface.vertices) <= 200
    assert (surface.vertex_map >= 0).all()


def test_sheets_joined_at_a_vertex_stay_connected():
    # The sheets share one corner. A collapse moves the corner of one sheet away, and a link then joins both sheets.
    square = sheet(columns=12, rows=12)
    width = np.ptp(square.vertices, axis=0)
    size = len(square.vertices)
    corner = int((square.vertices * [1, 1, 0]).sum(axis=1).argmax())
    start = int((square.vertices * [1, 1, 0]).sum(axis=1).argmin())
    vertices = np.concatenate([square.vertices, square.vertices + width])
    second = square.faces + size
    second[second == start + size] = corner
    surface = repair(vertices, np.concatenate([square.faces, second]), policy=MeshPolicy(max_vertices=20))
    assert surface.report.components == 1
    assert np.isfinite(geodesic_distances(surface, 0)).all()


@pytest.fixture
def restless_threads():
    """Switch threads as often as possible, so that data races show."""
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(interval)


def test_simplification_in_threads_is_deterministic(restless_threads):
    whole = SHAPES["ring"]
    with ThreadPoolExecutor(8) as pool:
        surfaces = list(pool.map(lambda most: simplified(whole, most), [100, 200, 300] * 8))
    for most in range(3):
        for surface in surfaces[most::3]:
            np.testing.assert_array_equal(surface.vertices, surfaces[most].vertices)
            np.testing.assert_array_equal(surface.faces, surfaces[most].faces)
            np.testing.assert_array_equal(surface.vertex_map, surfaces[most].vertex_map)


def test_a_mesh_that_cannot_be_simplified_is_refused():
    # All vertices but one are on a line, so that any collapse makes faces overlap.
    vertices = np.stack([np.arange(30.0), np.zeros(30), np.zeros(30)], axis=1)
    vertices[0, 1] = 1
    faces = [[i, i + 1, i + 2] for i in range(28)]
    with pytest.raises(MeshGeometryError, match=r"cannot be simplified to 10 vertices: .* are left"):
        repair(vertices, faces, policy=MeshPolicy(max_vertices=10))


def test_damaged_real_meshes_are_simplified(labelled):
    for path, _ in labelled("dirty"):
        surface = read_mesh(path, policy=MeshPolicy(components="bridge", max_vertices=400))
        assert len(surface.vertices) <= 400, path.name
        assert surface.report.relative_deviation < 0.1, path.name
        assert np.isfinite(geodesic_distances(surface, 0)).all(), path.name


def test_the_simplification_package_is_imported_only_on_demand():
    code = (
        "import sys; from unbend.mesh.shapes import sphere; from unbend.mesh.repair import repair; ball = sphere(1); "
        "repair(ball.vertices, ball.faces); print('fast_simplification' in sys.modules)"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "False"
