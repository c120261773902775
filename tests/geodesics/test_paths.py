"""Shortest paths compared with known results (flat and unrolled surfaces, exact geodesics), and on damaged meshes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, reject, settings
from hypothesis import strategies as st
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from tests.support.oracles import exact_distances, grid, mean_relative_error
from tests.support.polylines import distance_from_surface, length, path_lengths
from unbend import Surface, geodesic_distances, read_mesh
from unbend.errors import MeshGeometryError, ParameterError
from unbend.geodesics.paths.shortest import geodesic_path
from unbend.geodesics.paths.strips import strip_mesh
from unbend.mesh.shapes import cone, cylinder, sphere, torus

seeds = st.integers(0, 2**32 - 1)


def box(cells: int, sides: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> Surface:
    """Return a closed box whose edges have the lengths `sides`, with `cells` by `cells` rectangles on each face."""
    flat = grid(cells, cells)
    u = 2 * flat.vertices / cells - 1
    turns = [
        np.roll([u[:, 0], u[:, 1], np.full(len(u), side)], shift, axis=0) for shift in range(3) for side in (-1, 1)
    ]
    vertices, place = np.unique(np.round(np.hstack(turns).T, 9), axis=0, return_inverse=True)
    faces = np.concatenate([flat.faces + number * len(u) for number in range(6)])
    return Surface(vertices * np.array(sides) / 2, place.ravel()[faces])


def edge_distance(surface: Surface, source: int, target: int) -> float:
    tails, heads = surface.faces[:, [0, 1, 2]].ravel(), surface.faces[:, [1, 2, 0]].ravel()
    sides = np.unique(np.sort([tails, heads], axis=0), axis=1)
    lengths = np.linalg.norm(surface.vertices[sides[0]] - surface.vertices[sides[1]], axis=1)
    size = len(surface.vertices)
    graph = coo_array((np.maximum(lengths, 1e-300), (sides[0], sides[1])), shape=(size, size)).tocsr()
    return float(dijkstra(graph, directed=False, indices=source)[target])


def check_path(surface: Surface, source: int, target: int) -> np.ndarray:
    """Check the properties that every path has, on one path; return the path."""
    path = geodesic_path(surface, source, target)
    extent = np.ptp(surface.vertices[surface.used_vertices], axis=0).max()
    np.testing.assert_array_equal(path[0], surface.vertices[source])
    np.testing.assert_array_equal(path[-1], surface.vertices[target])
    assert distance_from_surface(surface, path) <= 1e-12 * extent
    assert length(path) >= np.linalg.norm(path[-1] - path[0]) * (1 - 1e-12)
    assert length(path) <= 1.01 * edge_distance(surface, source, target) + 1e-12 * extent
    assert length(geodesic_path(surface, target, source)) == pytest.approx(length(path), rel=1e-9, abs=1e-12 * extent)
    return path


@pytest.mark.parametrize("shear", [0.0, 0.5, 1.5, -4.0])
@pytest.mark.parametrize(("source", "target"), [(0, 335), (20, 315), (45, 297), (30, 31), (21, 41), (105, 216)])
def test_paths_on_a_flat_sheet_are_straight_lines(shear, source, target):
    surface = grid(20, 15, shear)  # a parallelogram, which is convex
    path = check_path(surface, source, target)
    straight = path[-1] - path[0]
    along = (path - path[0]) @ straight / (straight @ straight)
    np.testing.assert_allclose(path, path[0] + along[:, None] * straight, atol=1e-9)
    assert (np.diff(along) > 0).all()


@pytest.mark.parametrize("cells", [1, 2, 7])
@pytest.mark.parametrize("sides", [(1.0, 1.0, 1.0), (1.0, 2.0, 3.0), (5.0, 1.0, 1.0)])
def test_the_path_between_opposite_corners_of_a_box_has_the_known_length(cells, sides):
    surface = box(cells, sides)
    ends = np.flatnonzero(np.abs(np.abs(surface.vertices) - np.array(sides) / 2).max(axis=1) < 1e-9)
    source = ends[0]
    target = next(end for end in ends if np.allclose(surface.vertices[end], -surface.vertices[source]))
    a, b, c = sorted(sides)
    # The path crosses two sides; sqrt((a + b)^2 + c^2) is the shortest of the three nets.
    assert length(check_path(surface, source, target)) == pytest.approx(math.hypot(a + b, c), rel=1e-12)


def test_paths_on_a_cylinder_are_straight_lines_of_the_unrolled_prism():
    columns, rows, turn, width, height = 30, 10, 1.7 * math.pi, 3.0, 2.0
    surface = cylinder(turn, width=width, height=height, columns=columns, rows=rows)
    side = 2 * (width / turn) * math.sin(turn / columns / 2)  # the mesh is a prism with this side
    for source, target in ((0, 340), (31, 309), (5, 329), (310, 30)):
        across, up = abs(target % 31 - source % 31), abs(target // 31 - source // 31)
        expected = math.hypot(across * side, up * height / rows)
        assert length(check_path(surface, source, target)) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("inner", [0.0, 0.3])
def test_paths_on_a_cone_have_the_length_in_the_unrolled_sector(inner):
    segments, rings, sector = 24, 6, 1.5 * math.pi
    surface = cone(sector, 1.0, inner=inner, rings=rings, segments=segments)
    first = np.linalg.norm(surface.vertices[-1] - surface.vertices[-2])
    step = 2 * math.asin(first / 2)  # angle at the apex of a segment, whose sides have length 1
    size = len(surface.vertices)
    for across in (3, 12, 20, 24):
        path = check_path(surface, size - 1 - segments, size - 1 - segments + across)
        angle = across * step
        # The chord is the path unless it crosses the hole, or the angle exceeds a half turn.
        if angle < math.pi and math.cos(angle / 2) >= inner:
            assert length(path) == pytest.approx(2 * math.sin(angle / 2), rel=1e-12)
        elif inner == 0:
            assert length(path) == pytest.approx(2, rel=1e-12)
            assert (np.abs(path) < 1e-12).all(axis=1).any()
        else:
            tangent, around = math.sqrt(1 - inner**2), inner * (angle - 2 * math.acos(inner))
            assert length(path) == pytest.approx(2 * tangent + around, rel=0.005)  # the rim is a polygon


def test_path_lengths_on_a_sphere_converge_at_second_order():
    errors = []
    for subdivisions in (2, 3, 4):
        surface = sphere(subdivisions)
        field = geodesic_distances(surface, 0)[0]
        targets = np.arange(1, 42)  # these vertices are at the same points on every sphere
        lengths = path_lengths(strip_mesh(surface), field, 0, targets)
        arcs = np.arccos(np.clip(surface.vertices[targets] @ surface.vertices[0], -1, 1))
        errors.append(np.abs(lengths / arcs - 1).mean())
    assert errors[0] > 3 * errors[1] > 9 * errors[2]


def test_a_path_around_a_reflex_corner_bends_only_there():
    surface = grid(12, 12)
    middle = surface.vertices[surface.faces].mean(axis=1)
    sheet = Surface(surface.vertices, surface.faces[~((middle[:, 0] > 5) & (middle[:, 1] > 4))])
    path = check_path(sheet, 12 + 13 * 2, 2 + 13 * 12)  # from (12, 2) to (2, 12), around the corner (5, 4)
    assert length(path) == pytest.approx(math.hypot(7, 2) + math.hypot(3, 8), rel=1e-12)
    assert np.linalg.norm(path - [5, 4, 0], axis=1).min() == 0
    steps = np.diff(path, axis=0)
    directions = steps / np.linalg.norm(steps, axis=1)[:, None]
    assert (np.linalg.norm(np.diff(directions, axis=0), axis=1) > 1e-9).sum() == 1


def test_a_path_goes_around_a_spire_and_not_over_it():
    flat = grid(10, 10)
    height = np.where(np.arange(121) == 60, 50.0, 0.0)  # lifts the vertex in the middle
    surface = Surface(flat.vertices + height[:, None] * [0, 0, 1], flat.faces)
    path = check_path(surface, 5, 115)  # on the flat sheet, the path goes through that vertex
    assert path[:, 2].max() < 1
    assert length(path) == pytest.approx(exact_distances(surface, np.array([5]))[0, 115], rel=1e-9)


def test_paths_on_coarse_real_meshes_are_near_exact_geodesics(labelled):
    errors = []
    for number, (file, _) in enumerate(labelled("shrec11_simplified")[::60]):
        surface = read_mesh(file)
        rng = np.random.default_rng(number)
        for source, target in rng.choice(len(surface.vertices), (10, 2), replace=False):
            exact = exact_distances(surface, np.array([source]))[0, target]
            errors.append(length(geodesic_path(surface, source, target)) / exact - 1)
    assert len(errors) == 80
    assert min(errors) > -1e-9
    assert np.mean(errors) < 1e-4
    assert np.mean(np.array(errors) < 1e-9) > 0.97


@pytest.mark.parametrize("name", ["tosca5k/cat0.off", "single/human_man.obj"])
def test_paths_on_dense_real_meshes_are_near_exact_geodesics(shared_data, name):
    surface = read_mesh(shared_data / name)
    source, *targets = np.random.default_rng(0).choice(len(surface.vertices), 7, replace=False)
    exact = exact_distances(surface, np.array([source]))[0, targets]
    paths = [geodesic_path(surface, source, target) for target in targets]
    errors = np.array([length(path) for path in paths]) / exact - 1
    assert errors.min() > -1e-9
    assert errors.max() < 0.01
    assert errors.mean() < 5e-4
    assert max(distance_from_surface(surface, path) for path in paths) < 1e-12 * surface.vertices.max()


def test_path_lengths_are_more_accurate_than_the_distances_and_never_too_short(labelled):
    for file, _ in labelled("shrec11_simplified")[::240]:
        surface = read_mesh(file)
        every = np.arange(len(surface.vertices))
        fields, exact, mesh = geodesic_distances(surface, every), exact_distances(surface, every), strip_mesh(surface)
        lengths = np.array([path_lengths(mesh, field, source, every) for source, field in enumerate(fields)])
        assert not np.diagonal(lengths).any()
        exact = np.minimum(exact, exact.T)
        assert (lengths >= exact * (1 - 1e-9)).all()
        assert mean_relative_error(lengths, exact) < min(5e-4, 0.2 * mean_relative_error(fields, exact))


@pytest.mark.parametrize("name", ["teapot", "suzanne", "beetle", "cow", "human_neutral", "truck"])
def test_paths_on_damaged_real_meshes_are_valid(shared_data, name):
    surface = read_mesh(shared_data / "dirty" / f"{name}.obj")
    reached = np.flatnonzero(np.isfinite(geodesic_distances(surface, surface.used_vertices[0])[0]))
    rng = np.random.default_rng(0)
    for source, target in rng.choice(reached, (3, 2), replace=False):
        check_path(surface, source, target)


@given(seeds, st.floats(0.05, 0.6))
@settings(max_examples=60)
def test_paths_on_crumpled_sheets_are_rarely_longer_than_exact_ones(seed, rough):
    rng = np.random.default_rng(seed)
    flat = grid(7, 5)
    surface = Surface(flat.vertices + rng.normal(0, rough, flat.vertices.shape), flat.faces)
    source, target = rng.choice(len(surface.vertices), 2, replace=False)
    exact = exact_distances(surface, np.array([source]))[0]
    assert length(check_path(surface, source, target)) >= exact[target] * (1 - 1e-9)
    others = np.delete(np.arange(len(surface.vertices)), source)
    lengths = path_lengths(strip_mesh(surface), geodesic_distances(surface, source)[0], source, others)
    assert (lengths >= exact[others] * (1 - 1e-9)).all()
    assert np.median(lengths / exact[others]) < 1.001


@given(seeds, st.integers(4, 12), st.integers(1, 30), st.sampled_from([0.0, 1e-14, 1e-11, 1e-8, 1.0]))
def test_paths_on_random_triangles_stay_on_the_surface(seed, vertices, faces, noise):
    rng = np.random.default_rng(seed)
    # On this small lattice many vertices coincide or nearly coincide.
    points = rng.integers(0, 3, (vertices, 3)) + noise * rng.normal(size=(vertices, 3))
    surface = Surface(points, rng.integers(0, vertices, (faces, 3)))  # some faces repeat a vertex or another face
    source = surface.faces[0, 0]
    try:
        field = geodesic_distances(surface, source)[0]
    except MeshGeometryError:  # the edge lengths exceed the range of single precision
        reject()
    lengths = path_lengths(strip_mesh(surface), field, source, np.arange(vertices))
    np.testing.assert_array_equal(np.isfinite(lengths), np.isfinite(field))
    straight = np.linalg.norm(surface.vertices - surface.vertices[source], axis=1)
    assert ((lengths >= straight * (1 - 1e-9)) | (lengths == field)).all()
    others = np.flatnonzero(np.isfinite(field) & (np.arange(vertices) != source))
    assume(len(others))
    check_path(surface, source, rng.choice(others))


@given(seeds)
@settings(max_examples=60)
def test_path_lengths_do_not_depend_on_scale_position_numbering_or_orientation(seed):
    rng = np.random.default_rng(seed)
    flat = grid(6, 6)
    surface = Surface(flat.vertices + rng.normal(0, 0.3, flat.vertices.shape), flat.faces)
    order, scale = rng.permutation(len(surface.vertices)), 10.0 ** rng.integers(-30, 30)
    faces = np.argsort(order)[surface.faces][rng.permutation(len(surface.faces))]
    faces = np.array([np.roll(face[:: rng.choice([-1, 1])], rng.integers(3)) for face in faces])
    other = Surface((surface.vertices[order] + [3, -5, 7]) * scale, faces)
    source, target = rng.choice(len(order), 2, replace=False)
    place = np.argsort(order)
    assert length(geodesic_path(other, place[source], place[target])) == pytest.approx(
        scale * length(geodesic_path(surface, source, target)), rel=1e-9
    )


@pytest.mark.parametrize("seed", range(40))
def test_paths_reach_the_source_on_disturbed_distances(seed):
    rng = np.random.default_rng(seed)
    flat = grid(7, 5)
    surface = Surface(flat.vertices + rng.normal(0, rng.uniform(0, 1), flat.vertices.shape), flat.faces)
    mesh, field, targets = strip_mesh(surface), geodesic_distances(surface, 0)[0], np.arange(1, len(flat.vertices))
    exact = exact_distances(surface, np.array([0]))[0, 1:]
    ratios = []
    for fault in rng.uniform(0.1, 3, 20):
        spoilt = field + rng.uniform(0, fault, len(field)) * (field > 0)  # adds local minima
        lengths = path_lengths(mesh, spoilt, 0, targets)
        assert (lengths >= exact * (1 - 1e-9)).all()
        assert (lengths != spoilt[targets]).all()  # no path fell back to the given distance
        ratios.append(np.median(lengths / exact))
    assert np.mean(ratios) < 1.001


@pytest.mark.parametrize("field", [np.zeros(96), np.ones(96), np.arange(96.0), np.arange(96.0)[::-1]])
def test_paths_end_on_arbitrary_distances(field):
    surface = torus(columns=12, rows=8)
    lengths = path_lengths(strip_mesh(surface), field, 0, np.arange(96))
    exact = exact_distances(surface, np.array([0]))[0]
    assert ((lengths >= exact * (1 - 1e-9)) | (lengths == field)).all()
    assert np.isfinite(lengths).all()


def test_paths_cross_non_manifold_edges_and_degenerate_faces():
    wings = [[0, 0, 0], [1, 0, 0], [0.5, 1, 0], [0.5, -1, 0], [0.5, -0.5, 1]]
    three = Surface(wings, [[0, 1, 2], [1, 0, 3], [0, 1, 4]])
    assert length(check_path(three, 2, 3)) == pytest.approx(2)
    assert length(check_path(three, 2, 4)) == pytest.approx(1 + math.sqrt(1.25))
    bridge = Surface([*wings[:3], [3, 0, 0], [4, 0, 0], [3, 1, 0]], [[0, 1, 2], [1, 1, 3], [3, 4, 5]])
    assert length(check_path(bridge, 0, 4)) == pytest.approx(4)


def test_paths_pass_coincident_vertices():
    surface = Surface(
        [[0, 0, 0], [2, 0, 0], [1, 1, 0], [1, 1, 0], [1, 1, 0], [0, 2, 0], [2, 2, 0]],
        [[0, 1, 2], [1, 3, 2], [1, 4, 3], [1, 6, 4], [6, 5, 4], [5, 3, 4]],
    )
    assert length(check_path(surface, 0, 6)) == pytest.approx(2 * math.sqrt(2))
    np.testing.assert_array_equal(geodesic_path(surface, 2, 4), [[1, 1, 0], [1, 1, 0]])


def test_the_path_between_neighbours_is_their_edge():
    surface = sphere(2)
    for start, end in surface.faces[:20, :2]:
        np.testing.assert_array_equal(geodesic_path(surface, start, end), surface.vertices[[start, end]])
    np.testing.assert_array_equal(geodesic_path(surface, 7, 7), surface.vertices[[7]])


@pytest.mark.parametrize(
    ("source", "target", "message"),
    [
        (0, 9, "target: the mesh has no vertex 9"),
        (-1, 0, "source: the mesh has no vertex -1"),
        (0, 0.5, "target must be"),
        ([0, 1], 2, "source must be one vertex"),
        (0, 4, "target: no path leads from vertex 0 to vertex 4"),
        (0, 6, "target: no path leads from vertex 0 to vertex 6"),
    ],
)
def test_wrong_arguments_are_refused(source, target, message):
    one = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    surface = Surface([*one, *(one + 5), [9, 9, 9]], [[0, 1, 2], [3, 4, 5]])
    with pytest.raises(ParameterError, match=message):
        geodesic_path(surface, source, target)
