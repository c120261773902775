"""Stitching of seams: split surfaces are joined, surfaces that only touch are not, and vertices keep their order."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.defects import check_places, defective
from unbend import MeshPolicy, Surface, geodesic_distances, read_mesh
from unbend.errors import MeshError
from unbend.mesh.correspondence import at_given_vertices, surface_vertex
from unbend.mesh.repair import repair
from unbend.mesh.shapes import sheet, sphere, torus
from unbend.mesh.write import write_mesh

CASES = Path(__file__).parent / "cases"
BRIDGE, KEEP = MeshPolicy(components="bridge"), MeshPolicy(seams="keep")
CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
SIDES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
CUBE = CORNERS, np.array([half for a, b, c, d in SIDES for half in ((a, b, c), (a, c, d))])


def cut(vertices, faces, charts):
    """Return a mesh whose vertices have one copy for each chart; `charts` has the chart of each face."""
    keys = faces * (charts.max() + 1) + charts[:, None]
    copies, numbers = np.unique(keys, return_inverse=True)
    return vertices[copies // (charts.max() + 1)], numbers.reshape(faces.shape)


def soup(vertices, faces):
    return vertices[faces].reshape(-1, 3), np.arange(faces.size).reshape(-1, 3)


def sides(vertices, faces):
    """Return a mesh of a box with separate vertices for each side, as written by exporters that write normals."""
    return cut(vertices, faces, np.arange(len(faces)) // 2)


def box_charts(vertices, faces):
    normals = np.cross(*(vertices[faces[:, i]] - vertices[faces[:, 0]] for i in (1, 2)))
    axis = np.abs(normals).argmax(axis=1)
    return 2 * axis + (np.take_along_axis(normals, axis[:, None], axis=1)[:, 0] > 0)


def together(*meshes):
    offsets = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    faces = [faces + offset for (_, faces), offset in zip(meshes, offsets, strict=False)]
    return np.concatenate([vertices for vertices, _ in meshes]), np.concatenate(faces)


def moved(mesh, *by):
    return mesh[0] + np.array(by, float), mesh[1]


def closed(report):
    return (report.components, report.boundary_edges, report.nonmanifold_edges, report.nonmanifold_vertices) == (
        1, 0, 0, 0,
    )  # fmt: skip


WAYS = {
    "soup": soup,
    "box": lambda v, f: cut(v, f, box_charts(v, f)),
    "pairs": sides,
    "stripes": lambda v, f: cut(v, f, np.arange(len(f)) // 7 % 3),
}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("whole", [sphere(3), torus(), sheet(columns=8, rows=5)], ids=["sphere", "torus", "sheet"])
def test_a_surface_with_split_vertices_is_restored(whole, way):
    vertices, faces = WAYS[way](whole.vertices, whole.faces)
    surface = repair(vertices, faces)
    assert surface.report.components == 1
    assert surface.report.boundary_edges == whole.edges.boundary
    assert surface.report.seams == (Surface(vertices, faces).edges.boundary - whole.edges.boundary) / 2
    np.testing.assert_array_equal(surface.vertices[surface.faces], whole.vertices[whole.faces])
    assert len(surface.vertices) == len(whole.vertices)
    assert (surface.report.coincident_vertices, surface.report.seam_tolerance) == (0, None)
    check_places(surface, vertices)


@pytest.mark.parametrize("file_type", ["ply", "obj", "glb"])
def test_all_copies_of_a_vertex_have_the_distance_of_the_original_mesh(file_type):
    ball = sphere(2)
    vertices, faces = soup(ball.vertices, ball.faces)
    surface = read_mesh(write_mesh(vertices, faces, file_type))
    assert surface.report.vertices == len(vertices)
    source = 17
    found = at_given_vertices(surface, geodesic_distances(surface, surface_vertex(surface, source, "source"))[0])
    whole = geodesic_distances(ball, int(ball.faces.ravel()[source]))[0]
    np.testing.assert_allclose(found, whole[ball.faces.ravel()], rtol=1e-4, atol=1e-6)
    assert max(Counter(found.tolist()).values()) >= 5
    for vertex in range(len(vertices)):
        same = (vertices == vertices[vertex]).all(axis=1)
        assert len(set(found[same].tolist())) == 1


def test_the_vertex_map_of_a_stitched_and_simplified_mesh_refers_to_the_file():
    ball = sphere(3)
    vertices, faces = soup(ball.vertices, ball.faces)
    surface = repair(vertices, faces, policy=MeshPolicy(max_vertices=150))
    assert surface.vertex_map.shape == (len(vertices),)
    assert np.linalg.norm(surface.vertices[surface.vertex_map] - vertices, axis=1).max() < 0.3
    whole = repair(ball.vertices, ball.faces, policy=MeshPolicy(max_vertices=150))
    np.testing.assert_array_equal(surface.vertex_map, whole.vertex_map[ball.faces.ravel()])


@pytest.mark.parametrize(
    ("name", "vertices", "area"),
    [("ply_flat_cube_24.ply", 8, 52), ("glb_flat_cube_24.glb", 8, 52), ("stl_noise_last_digit.stl", 6, 9.407465)],
)
def test_files_with_split_vertices_become_closed_surfaces(name, vertices, area):
    surface = read_mesh(CASES / name)
    assert closed(surface.report)
    assert len(surface.vertices) == vertices
    assert surface.area == pytest.approx(area, rel=1e-5)


def test_unused_vertices_are_kept():
    vertices, faces = sides(*CUBE)
    vertices = np.concatenate([[[0, 0, 0]], vertices, [[np.nan, 7, 7]]])
    surface = repair(vertices, faces + 1)
    assert closed(surface.report)
    assert (len(surface.vertices), surface.report.isolated_vertices) == (10, 2)
    assert (surface.vertex_map[0], surface.vertex_map[-1]) == (0, 9)


def test_positive_and_negative_zeros_are_equal_coordinates():
    vertices, faces = sides(*CUBE)
    vertices[::2] *= np.where(vertices[::2] == 0, -1.0, 1.0)
    assert closed(repair(vertices, faces).report)


@pytest.mark.parametrize("scale", [1e-120, 1e-30, 1.0, 1e30, 1e120])
@pytest.mark.parametrize("way", [soup, sides], ids=["soup", "sides"])
def test_copies_that_differ_in_the_last_digits_are_joined_in_any_unit(scale, way):
    rng = np.random.default_rng(0)
    vertices, faces = way(*CUBE)
    vertices = scale * (vertices + rng.uniform(-1e-7, 1e-7, vertices.shape))
    surface = repair(vertices, faces)
    assert closed(surface.report)
    assert surface.report.seam_tolerance == pytest.approx(1e-6 * scale, rel=1e-3)
    assert any("last digits" in note for note in surface.report.notes)
    assert (surface.report.coincident_vertices, len(surface.vertices)) == (0, 8)
    check_places(surface, vertices)


def test_a_gap_wider_than_the_tolerance_is_not_joined():
    vertices, faces = together(CUBE, moved(CUBE, 1 + 1e-5, 0, 0))
    assert repair(vertices, np.delete(faces, [10, 11, 12, 13], axis=0), policy=BRIDGE).report.seams == 0


def test_features_of_the_size_of_the_tolerance_are_not_joined():
    tiny = sheet(columns=6, rows=6, width=2e-6, height=2e-6)
    far = moved((tiny.vertices, tiny.faces), 0.9e-6, 0, 0)
    vertices, faces = together((tiny.vertices, tiny.faces), far, moved(CUBE, 3, 3, 3))
    assert repair(vertices, faces, policy=BRIDGE).report.seams == 0


@pytest.mark.parametrize("inside_out", [False, True])
@pytest.mark.parametrize("way", [sides, soup], ids=["sides", "soup"])
@pytest.mark.parametrize("by", [(1, 1, 0), (1, 1, 1)], ids=["edge", "vertex"])
def test_boxes_that_touch_at_an_edge_or_vertex_stay_separate(by, way, inside_out):
    vertices, faces = together(way(*CUBE), way(*moved(CUBE, *by)))
    faces = faces[:, ::-1] if inside_out else faces
    surface = repair(vertices, faces, policy=BRIDGE)
    report = surface.report
    assert (report.components, report.boundary_edges, report.nonmanifold_edges) == (2, 0, 0)
    assert len(surface.vertices) == 16
    assert report.coincident_vertices == (2 if by[2] == 0 else 1)


@pytest.mark.parametrize("by", [(1, 0, 0), (0, 0, 0)], ids=["side by side", "at one place"])
def test_boxes_with_coincident_sides_stay_separate(by):
    report = repair(*together(sides(*CUBE), sides(*moved(CUBE, *by))), policy=BRIDGE).report
    assert (report.components, report.boundary_edges, report.nonmanifold_edges) == (2, 0, 0)


def test_duplicate_and_degenerate_faces_of_a_soup_are_dropped():
    vertices, faces = together(soup(*CUBE), soup(CORNERS, np.array([[3, 1, 0], [0, 1, 0]])))
    vertices[-1] = 0.0
    surface = repair(vertices, faces)
    assert closed(surface.report)
    assert (surface.report.duplicate_faces, surface.report.degenerate_faces) == (1, 1)
    assert (surface.vertex_map[-6:] < 8).all()
    np.testing.assert_array_equal(surface.vertices[surface.vertex_map], vertices)


def test_duplicate_faces_of_a_noisy_soup_are_dropped():
    vertices, faces = soup(*CUBE)
    vertices, faces = together((vertices, faces), (vertices[:3], faces[:1]), (vertices[:3], faces[:1, ::-1]))
    vertices = vertices + np.random.default_rng(0).uniform(-1e-7, 1e-7, vertices.shape)
    surface = repair(vertices, faces)
    assert closed(surface.report)
    assert (surface.report.duplicate_faces, len(surface.faces)) == (2, 12)


def test_edges_too_short_for_a_direction_cause_no_wrong_joins():
    tiny = CORNERS * [1.0, 1.0, 1e-320]
    vertices, faces = together(sides(tiny, CUBE[1]), sides(*moved((tiny, CUBE[1]), 1, 1, 0)))
    assert repair(vertices, faces, policy=BRIDGE).report.nonmanifold_edges == 0


def test_of_three_walls_at_an_edge_two_are_joined_or_all_three_in_a_soup():
    corners = np.array([[0, 0, 0], [0, 0, 1], [1, 0, 0], [1, 0, 1], [-1, 0, 0], [-1, 0, 1], [0, 1, 0], [0, 1, 1.0]])
    quads = [(0, 2, 3, 1), (0, 1, 5, 4), (0, 1, 7, 6)]
    walls = corners, np.array([half for a, b, c, d in quads for half in ((a, b, c), (a, c, d))])
    one = repair(*soup(*walls)).report
    assert (one.components, one.nonmanifold_edges, one.seams) == (1, 1, 5)
    apart = repair(*sides(*walls), policy=BRIDGE).report
    assert (apart.components, apart.nonmanifold_edges, apart.seams) == (2, 0, 1)


@pytest.mark.parametrize("flipped", [False, True])
def test_a_fin_at_a_seam_does_not_prevent_the_join(flipped):
    a, b = SIDES[0][0], SIDES[0][1]  # an edge between two sides; the fin is outside the box
    tip = np.vstack([CORNERS[[a, b]], CORNERS[a] - [1.0, 1.0, 0.0]])
    fin = np.array([[0, 1, 2], [1, 0, 2]][flipped])[None]
    report = repair(*together(sides(*CUBE), (tip, fin)), policy=BRIDGE).report
    assert (report.components, report.nonmanifold_edges, report.boundary_edges) == (2, 0, 3)


def test_the_two_sides_of_a_sheet_are_not_joined():
    flat = sheet(columns=4, rows=3)
    vertices, faces = together((flat.vertices, flat.faces), (flat.vertices, flat.faces[:, ::-1]))
    report = repair(vertices, faces, policy=BRIDGE).report
    assert (report.components, report.seams) == (2, 0)


def test_faces_of_opposite_orientation_are_joined():
    vertices, faces = sides(*CUBE)
    faces[2:4] = faces[2:4, ::-1]
    faces[8:10] = faces[8:10, ::-1]
    report = repair(vertices, faces).report
    assert closed(report)
    assert report.misoriented_edges > 0


def test_coincident_vertices_inside_a_surface_are_not_joined(labelled):
    for path, _ in labelled("faust5k"):
        surface = read_mesh(path)
        assert (surface.vertex_map, surface.report.seams) == (None, 0), path.name


def test_keeping_less_than_nine_tenths_of_the_area_is_a_warning():
    vertices, faces = together(CUBE, moved(CUBE, 5, 0, 0))
    report = repair(vertices, faces).report
    assert report.area_kept == pytest.approx(0.5)
    assert len(report.warnings) == 1
    for part in ("50.0% of the area", "2 components", 'components="bridge"'):
        assert part in report.warnings[0]
    assert report.as_dict()["warnings"] == list(report.warnings)
    whole = repair(vertices, faces, policy=BRIDGE).report
    assert (whole.area_kept, whole.warnings) == (1.0, ())
    small = repair(*together(CUBE, moved((0.1 * CORNERS, CUBE[1]), 5, 0, 0))).report
    assert (small.components, small.warnings) == (2, ())
    torn = repair(*sides(*CUBE), policy=KEEP).report
    assert 'seams="stitch"' in torn.warnings[0]


def test_a_mesh_connected_by_stitching_is_not_refused_for_its_components():
    one = MeshPolicy(components="error")
    assert closed(repair(*sides(*CUBE), policy=one).report)
    with pytest.raises(MeshError, match="6 components"):
        repair(*sides(*CUBE), policy=MeshPolicy(components="error", seams="keep"))


@given(defective(), st.sampled_from(sorted(WAYS)))
def test_stitching_adds_no_non_manifold_edge_and_loses_no_face(mesh, way):
    try:
        vertices, faces = WAYS[way](mesh.vertices, mesh.faces) if way == "soup" else (mesh.vertices, mesh.faces)
        kept = repair(vertices, faces, policy=MeshPolicy(components="bridge", seams="keep"))
        surface = repair(vertices, faces, policy=BRIDGE)
    except (MeshError, IndexError):
        return
    check_places(surface, vertices)
    assert surface.report.components <= kept.report.components
    assert surface.report.boundary_edges <= kept.report.boundary_edges
    if way != "soup":
        assert surface.report.nonmanifold_edges <= kept.report.nonmanifold_edges
        assert len(surface.faces) - surface.report.links == len(kept.faces) - kept.report.links
