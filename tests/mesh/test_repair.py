"""Repair of damaged meshes: the defects found, the repairs, and what repair never changes."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from unbend import MeshPolicy, Surface, geodesic_distances
from unbend.errors import MeshGeometryError, ParameterError
from unbend.mesh import rows
from unbend.mesh.repair import repair
from unbend.mesh.shapes import sheet, sphere, torus

KEEP = MeshPolicy(seams="keep")
BALL = sphere(2)
SIZE = len(BALL.vertices)
A, B, C = (int(corner) for corner in BALL.faces[-1])
COUNTS = (
    "boundary_edges", "boundary_loops", "coincident_vertices", "degenerate_faces", "duplicate_faces",
    "isolated_vertices", "links", "misoriented_edges", "nonfinite_faces", "nonfinite_vertices", "nonmanifold_edges",
    "nonmanifold_vertices", "zero_area_faces",
)  # fmt: skip


def found(surface):
    """Return the counts of the report that are not zero."""
    return {name: value for name in COUNTS if (value := getattr(surface.report, name))}


def vertices_with(*points):
    return np.concatenate([BALL.vertices, np.array(points, float)])


def faces_with(*faces):
    return np.concatenate([BALL.faces, np.array(faces, np.int32)])


def torn():
    """Return the ball with a copy of vertex A, which the last face uses instead of A."""
    faces = BALL.faces.copy()
    faces[-1][faces[-1] == A] = SIZE
    return vertices_with(BALL.vertices[A]), faces


def not_finite(value):
    vertices = BALL.vertices.copy()
    vertices[A, 1] = value
    return vertices, BALL.faces


VALENCE = int((BALL.faces == A).sum())
HOLE = {
    "nonfinite_vertices": 1,
    "nonfinite_faces": VALENCE,
    "isolated_vertices": 1,
    "boundary_edges": VALENCE,
    "boundary_loops": 1,
}
ISLAND = [[5, 0, 0], [5, 0.1, 0], [5, 0, 0.1]]

# The defects that break other libraries: a sphere with one defect each, and the expected counts.
DEFECTS = {
    "two components": (vertices_with(*ISLAND), faces_with([SIZE, SIZE + 1, SIZE + 2]), {}),
    "isolated vertex": (vertices_with([5, 5, 5]), BALL.faces, {"isolated_vertices": 1}),
    "non-manifold edge": (
        vertices_with(1.2 * BALL.vertices[A]),
        faces_with([A, B, SIZE]),
        {"nonmanifold_edges": 1, "boundary_edges": 2, "boundary_loops": 1},
    ),
    "non-manifold vertex": (
        vertices_with([2, 0, 0], [2, 1, 0]),
        faces_with([A, SIZE, SIZE + 1]),
        {"nonmanifold_vertices": 1, "boundary_edges": 3, "boundary_loops": 1},
    ),
    "duplicate face": (BALL.vertices, faces_with([B, C, A], [C, B, A]), {"duplicate_faces": 2}),
    "degenerate face": (BALL.vertices, faces_with([A, A, B], [C, C, C]), {"degenerate_faces": 2}),
    "coincident vertices": (*torn(), {"coincident_vertices": 1, "boundary_edges": 4, "boundary_loops": 1}),
    "one NaN vertex": (*not_finite(np.nan), HOLE),
    "one infinite vertex": (*not_finite(-np.inf), HOLE),
    "a face the other way round": (
        BALL.vertices,
        np.concatenate([BALL.faces[:-1], BALL.faces[-1:, ::-1]]),
        {"misoriented_edges": 3},
    ),
    "a face missing": (BALL.vertices, BALL.faces[:-1], {"boundary_edges": 3, "boundary_loops": 1}),
}


@pytest.mark.parametrize(("vertices", "faces", "expected"), DEFECTS.values(), ids=DEFECTS)
def test_every_defect_is_found_and_noted_without_moving_vertices(vertices, faces, expected):
    surface = repair(vertices, faces, policy=KEEP)
    assert found(surface) == expected
    assert len(surface.report.notes) == len(expected) - ("nonfinite_vertices" in expected) + (
        surface.report.components > 1
    )
    np.testing.assert_array_equal(surface.vertices, vertices)
    assert (surface.report.vertices, surface.report.faces) == (len(vertices), len(faces))


@pytest.mark.parametrize(("vertices", "faces", "expected"), DEFECTS.values(), ids=DEFECTS)
def test_distances_on_a_damaged_sphere_equal_those_on_the_intact_one(vertices, faces, expected):
    source = int(np.linalg.norm(BALL.vertices - BALL.vertices[A], axis=1).argmax())
    surface = repair(vertices, faces, policy=KEEP)
    distances = geodesic_distances(surface, source)[0]
    assert not np.isnan(distances).any()
    reached = np.isfinite(distances)
    np.testing.assert_array_equal(np.flatnonzero(reached), surface.used_vertices)
    reached = np.flatnonzero(reached[:SIZE])
    whole = geodesic_distances(BALL, source)[0]
    np.testing.assert_allclose(distances[reached], whole[reached], rtol=0.02)


def test_several_defects_are_counted_separately():
    vertices = vertices_with([np.nan] * 3, [7, 7, 7], BALL.vertices[A])
    faces = faces_with([B, C, SIZE], [B, C, C], [A, B, C], [SIZE + 2, B, C])
    surface = repair(vertices, faces)
    assert found(surface) == {
        "nonfinite_vertices": 1,
        "nonfinite_faces": 1,
        "degenerate_faces": 1,
        "duplicate_faces": 1,
        "isolated_vertices": 2,
        "coincident_vertices": 1,
        "nonmanifold_edges": 1,
        "boundary_edges": 2,
        "boundary_loops": 1,
    }
    np.testing.assert_array_equal(surface.faces, faces_with([SIZE + 2, B, C]))


def test_faces_of_zero_area_are_counted_and_kept():
    # The common side of two squares has a middle vertex in one square only; a face without area closes the slit.
    vertices = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 1, 0], [0, 2, 0], [1, 2, 0]]
    faces = [[0, 1, 2], [0, 2, 3], [3, 4, 5], [4, 6, 5], [4, 2, 6], [3, 2, 4]]
    surface = repair(vertices, faces)
    assert found(surface)["zero_area_faces"] == 1
    assert surface.report.boundary_loops == 1
    np.testing.assert_array_equal(surface.faces, faces)
    assert geodesic_distances(surface, 4)[0, 1] == pytest.approx(np.hypot(0.5, 1.0), rel=0.05)


@pytest.mark.parametrize("small", [1.0, 1e-7])
@pytest.mark.parametrize(("height", "count"), [(1e-6, 0), (1e-12, 1)])
def test_thin_and_small_faces_do_not_count_as_zero_area(small, height, count):
    vertices = np.array([[0, 0, 0], [small, 0, 0], [0.5 * small, height * small, 0], [1, 0, 0], [0, 1, 0]])
    assert repair(vertices, [[0, 1, 2], [0, 3, 4]]).report.zero_area_faces == count


@pytest.mark.parametrize("scale", [1e-120, 1e-30, 1e30, 1e120])
def test_repair_does_not_depend_on_the_unit(scale):
    vertices, faces, expected = DEFECTS["coincident vertices"]
    surface = repair(scale * vertices, faces, policy=KEEP)
    assert found(surface) == expected
    assert surface.area / scale / scale == pytest.approx(BALL.area)


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 3]], "face 0 uses vertices .*, but the mesh has 3"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2], [0, 1, -1]], "face 1"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2**40]], "face 0"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.empty((0, 3), int), "no faces"),
        ([[0, 0, 0], [1, 0, 0], [0, np.nan, 0]], [[0, 1, 2]], "vertex 2 has coordinates .*nan.* not finite"),
        ([[0, 0, 0], [1, 0, 0], [0, np.inf, 0], [2, 0, 0]], [[0, 1, 2], [0, 1, 3]], "vertex 2 .*no face with an area"),
        ([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]], "every face has zero area"),
        ([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 1]], "three different vertices"),
        ([[0, 0, 0], [1e200, 0, 0], [0, 1e200, 0]], [[0, 1, 2]], "scale its coordinates"),
    ],
)
def test_a_mesh_without_a_surface_is_refused_with_the_reason(vertices, faces, message):
    with pytest.raises(MeshGeometryError, match=message):
        repair(vertices, faces)


@pytest.mark.parametrize(
    ("surface", "loops"), [(torus(), 0), (sheet(columns=4, rows=3), 1), (BALL, 0)], ids=["torus", "sheet", "ball"]
)
def test_boundary_loops_are_counted(surface, loops):
    assert repair(surface.vertices, surface.faces).report.boundary_loops == loops


def test_two_faces_that_share_a_vertex_have_two_boundary_loops():
    two = repair([[0, 0, 0], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]], [[0, 1, 2], [0, 3, 4]])
    assert (two.report.nonmanifold_vertices, two.report.boundary_loops) == (1, 2)


def test_a_moebius_strip_cannot_be_oriented():
    angles = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    across = (
        np.array([-0.3, 0.3])[None, :, None]
        * np.stack(
            [np.cos(angles / 2) * np.cos(angles), np.cos(angles / 2) * np.sin(angles), np.sin(angles / 2)], axis=1
        )[:, None]
    )
    strip = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)[:, None] + across
    faces = []
    for i in range(12):
        a, b, c, d = 2 * i, 2 * i + 1, 2 * i + 2, 2 * i + 3
        if i == 11:
            c, d = 1, 0
        faces += [[a, b, c], [b, d, c]]
    report = repair(strip.reshape(-1, 3), faces).report
    assert (report.misoriented_edges, report.boundary_loops, report.nonmanifold_vertices) == (1, 1, 0)


def test_components_are_dropped_linked_or_refused_by_policy():
    vertices, faces, _ = DEFECTS["two components"]
    assert len(repair(vertices, faces).faces) == len(BALL.faces)
    assert len(repair(vertices, faces, policy=MeshPolicy(components="bridge")).faces) == len(faces) + 1
    with pytest.raises(MeshGeometryError, match="2 components"):
        repair(vertices, faces, policy=MeshPolicy(components="error"))


@pytest.mark.parametrize(
    "arguments",
    [{"components": "smallest"}, {"max_vertices": 3}, {"max_vertices": True}, {"max_vertices": 100.0}],
)
def test_an_invalid_policy_raises_parameter_error(arguments):
    with pytest.raises(ParameterError, match=next(iter(arguments))):
        MeshPolicy(**arguments)


def test_the_report_can_be_stored_as_json():
    vertices, faces, _ = DEFECTS["two components"]
    surface = repair(vertices, faces, policy=MeshPolicy(components="bridge", max_vertices=100))
    stored = json.loads(json.dumps(surface.report.as_dict(), allow_nan=False))
    assert stored["links"] == surface.report.links
    assert stored["notes"] == list(surface.report.notes)


DAMAGES = st.lists(
    st.tuples(st.sampled_from(["duplicate", "repeat", "nan", "isolated", "island", "twin", "flip", "fin"]),
              st.integers(0, 79), st.integers(0, 2)),
    max_size=12,
)  # fmt: skip


def damaged(damages):
    """Apply the damages (kind, face, corner) to a sphere of 80 faces; return vertices and faces."""
    ball = sphere(1)
    vertices, faces = [list(point) for point in ball.vertices], [list(face) for face in ball.faces.tolist()]
    for kind, number, corner in damages:
        face, size = faces[number], len(vertices)
        if kind == "duplicate":
            faces.append([face[corner], face[corner - 1], face[corner - 2]])
        elif kind == "repeat":
            faces.append([face[corner], face[corner], face[corner - 1]])
        elif kind == "nan":
            vertices[face[corner]] = [np.nan, 0.0, 0.0]
        elif kind == "isolated":
            vertices.append([9.0, 9.0, number])
        elif kind == "island":
            vertices += [[5.0, size, 0], [5.0, size + 0.1, 0], [5.0, size, 0.1]]
            faces.append([size, size + 1, size + 2])
        elif kind == "twin":
            vertices.append(list(vertices[face[corner]]))
            faces.append([face[corner - 1], face[corner - 2], size])
        elif kind == "flip":
            face.reverse()
        else:
            vertices.append([2.0, size, number])
            faces.append([face[corner], face[corner - 1], size])
    return np.array(vertices), np.array(faces)


@given(DAMAGES, st.sampled_from(["largest", "bridge"]))
def test_repair_keeps_all_vertices_and_all_intact_faces(damages, components):
    vertices, faces = damaged(damages)
    surface = repair(vertices, faces, policy=MeshPolicy(components=components, seams="keep"))
    np.testing.assert_array_equal(surface.vertices, vertices)
    kept = surface.faces[: len(surface.faces) - surface.report.links].tolist()
    seen, sound = set(), []
    for face in faces.tolist():
        if np.isfinite(vertices[face]).all() and len(set(face)) == 3 and frozenset(face) not in seen:
            seen.add(frozenset(face))
            sound.append(face)
    if components == "bridge" or surface.report.components == 1:
        assert kept == sound
    else:
        assert [face for face in sound if face in kept] == kept
    dropped = surface.report.nonfinite_faces + surface.report.degenerate_faces + surface.report.duplicate_faces
    assert dropped == len(faces) - len(sound)


@given(DAMAGES)
def test_non_manifold_vertices_boundaries_and_orientation_equal_a_plain_count(damages):
    vertices, faces = damaged(damages)
    surface = repair(vertices, faces, policy=MeshPolicy(components="bridge", seams="keep"))
    kept = surface.faces[: len(surface.faces) - surface.report.links].tolist()
    by_edge = {}
    for number, face in enumerate(kept):
        for i in range(3):
            by_edge.setdefault(frozenset((face[i], face[i - 1])), []).append((number, (face[i - 1], face[i])))
    fans = {vertex: sets_of({n: [m for e in edges_at(face, vertex) for m, _ in by_edge[e]]
                             for n, face in enumerate(kept) if vertex in face})
            for vertex in {corner for face in kept for corner in face}}  # fmt: skip
    assert surface.report.nonmanifold_vertices == sum(len(parts) > 1 for parts in fans.values())
    misoriented = [users for users in by_edge.values() if len(users) == 2 and users[0][1] == users[1][1]]
    assert surface.report.misoriented_edges == len(misoriented)
    rims = {}
    for edge, users in by_edge.items():
        if len(users) == 1:
            for vertex in edge:
                fan = next(i for i, part in enumerate(fans[vertex]) if users[0][0] in part)
                rims.setdefault(edge, []).append((vertex, fan))
    touching = {edge: [other for other, ends in rims.items() if set(ends) & set(rims[edge])] for edge in rims}
    assert surface.report.boundary_loops == len(sets_of(touching))


def edges_at(face, vertex):
    return [frozenset((vertex, corner)) for corner in face if corner != vertex]


def sets_of(neighbours):
    """Return the connected sets of a graph {node: neighbours}; neighbours that are no nodes are ignored."""
    left, sets = set(neighbours), []
    while left:
        reached, border = set(), [min(left, key=str)]
        while border:
            node = border.pop()
            if node in left:
                left.remove(node)
                reached.add(node)
                border += neighbours[node]
        sets.append(reached)
    return sets


@given(st.lists(st.lists(st.sampled_from([0.0, -0.0, 1.0, 1e-300, np.inf]), min_size=3, max_size=3), max_size=40))
def test_equal_points_are_found_despite_hash_collisions(points):
    points = np.array(points, float).reshape(-1, 3)
    first = [next(j for j in range(i + 1) if (points[j] == points[i]).all()) for i in range(len(points))]
    np.testing.assert_array_equal(rows.equal_points(points), first)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rows, "_mix", lambda keys: keys & np.uint64(1))  # nearly all rows share a hash
        np.testing.assert_array_equal(rows.equal_points(points), first)


def test_the_class_surface_refuses_vertices_that_are_not_finite():
    vertices, faces = not_finite(np.nan)
    with pytest.raises(MeshGeometryError, match=f"vertex {A} "):
        Surface(vertices, faces)
