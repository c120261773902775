"""Triangulation of polygons: the triangles cover any polygon once, and do not depend on the file format."""

from __future__ import annotations

import struct
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from unbend import read_mesh
from unbend.errors import MeshReadError, MeshTooLargeError
from unbend.mesh.formats.polygons import triangulated
from unbend.mesh.limits import UNLIMITED, MeshLimits


def cut(outline, rings=None):
    """Return the triangles and notes of one polygon, or of several."""
    points = np.asarray(outline, float)
    rings = [range(len(points))] if rings is None else rings
    corners = np.array([corner for ring in rings for corner in ring], np.int64)
    return triangulated(points, corners, np.array([len(ring) for ring in rings], np.int64), UNLIMITED)


def areas(points, faces):
    corners = np.asarray(points, float)[faces]
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2


def in_plane(outline):
    return np.column_stack([outline, np.zeros(len(outline))])


@st.composite
def star_shapes(draw):
    """Draw a simple, mostly concave polygon anywhere in space, starting at any corner."""
    count = draw(st.integers(4, 30))
    radii = np.array(draw(st.lists(st.floats(0.1, 10), min_size=count, max_size=count)))
    angles = 2 * np.pi * (np.arange(count) + 0.3 * np.sin(np.arange(count))) / count
    outline = np.column_stack([radii * np.cos(angles), radii * np.sin(angles)])
    outline = np.roll(outline, draw(st.integers(0, count)), axis=0)
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    frame = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return in_plane(outline) @ frame.T * 10.0 ** draw(st.integers(-9, 9)) + rng.normal(size=3)


def shoelace(points):
    """Return the vector area of an outline."""
    around = points - points[0]
    return np.cross(around[:-1], around[1:]).sum(axis=0) / 2


@given(star_shapes())
def test_triangles_cover_a_polygon_once_with_its_orientation(points):
    faces, notes = cut(points)
    whole = shoelace(points)
    size = np.linalg.norm(whole)
    pieces = areas(points, faces)
    assert len(faces) == len(points) - 2
    assert notes == ()
    np.testing.assert_allclose(pieces.sum(axis=0), whole, atol=1e-6 * size)
    assert np.linalg.norm(pieces, axis=1).sum() == pytest.approx(size, rel=1e-5)


@given(star_shapes())
def test_the_boundary_of_the_triangles_is_the_outline(points):
    faces, _ = cut(points)
    edges = {(a, b) for face in faces.tolist() for a, b in zip(face, face[1:] + face[:1], strict=True)}
    boundary = {edge for edge in edges if edge[::-1] not in edges}
    assert boundary == {(corner, (corner + 1) % len(points)) for corner in range(len(points))}


def test_collinear_corners_are_kept():
    outline = [
        [0, 0],
        [1, 0],
        [2, 0],
        [3, 0],
        [3, 3],
        [2, 3],
        [2, 1],
        [1.5, 1],
        [1, 1],
        [1, 3],
        [0.5, 3],
        [0, 3],
        [0, 1],
    ]
    points = in_plane(outline)
    for first in range(len(points)):
        turned = np.roll(points, first, axis=0)
        faces, notes = cut(turned)
        assert set(faces.ravel()) == set(range(len(points)))
        assert np.abs(areas(turned, faces)[:, 2]).sum() == pytest.approx(7)
        assert notes == ()


def test_a_hole_connected_to_the_outline_stays_a_hole():
    points = in_plane([[0, 0], [4, 0], [4, 4], [0, 4], [1, 1], [1, 3], [3, 3], [3, 1], [0, 0], [1, 1]])
    for ring in ([0, 1, 2, 3, 0, 4, 5, 6, 7, 4], [0, 1, 2, 3, 8, 9, 5, 6, 7, 4]):
        for turn in range(len(ring)):
            faces, notes = cut(points, [np.roll(ring, turn)])
            np.testing.assert_array_less(0, areas(points, faces)[:, 2])
            assert areas(points, faces)[:, 2].sum() == pytest.approx(12)
            assert set(faces.ravel()) == set(ring)
            assert notes == ()


def test_a_spiral_of_thousands_of_corners_is_cut_in_seconds():
    turn = np.linspace(0, 8 * np.pi, 4000)
    inner, outer = (np.column_stack([(turn + d) * np.cos(turn), (turn + d) * np.sin(turn)]) for d in (0, 2))
    points = in_plane(np.concatenate([inner, outer[::-1]]))
    begun = time.process_time()
    faces, notes = cut(points)
    assert time.process_time() - begun < 3
    assert np.abs(areas(points, faces)[:, 2]).sum() == pytest.approx(np.linalg.norm(shoelace(points)))
    assert notes == ()


def test_convex_polygons_become_fans_around_their_first_corner():
    angles = np.arange(7) * 2 * np.pi / 7
    faces, _ = cut(in_plane(np.column_stack([np.cos(angles), np.sin(angles)])))
    assert faces.tolist() == [[0, i, i + 1] for i in range(1, 6)]
    saddle = [[0, 0, 1], [1, 0, 0], [1, 1, 1], [0, 1, 0]]
    assert cut(saddle)[0].tolist() == [[0, 1, 2], [0, 2, 3]]


@pytest.mark.parametrize("first", range(4))
def test_a_dart_is_cut_at_its_reflex_corner(first):
    points = in_plane(np.roll([[0, 0], [2, 0], [0.5, 0.5], [0, 2]], first, axis=0))
    faces, notes = cut(points)
    np.testing.assert_allclose(areas(points, faces)[:, 2], 0.5)
    assert notes == ()


def test_mixed_polygons_keep_their_order():
    points = in_plane([[0, 0], [2, 0], [0.5, 0.5], [0, 2], [4, 4], [5, 4], [5, 5]])
    faces, notes = cut(points, [(4, 5, 6), (1, 2, 3, 0), (0, 1), (4, 5, 5, 6), (6, 5, 4)])
    assert faces[[0, -1]].tolist() == [[4, 5, 6], [6, 5, 4]]
    assert faces[3].tolist() == [4, 5, 6]
    assert sorted(faces[1:3].ravel().tolist()) == [0, 0, 1, 2, 2, 3]
    assert notes == ("1 repeated corner skipped", "1 face of fewer than three corners skipped")


@pytest.mark.parametrize(
    "outline",
    [
        [[0, 0], [1, 1], [1, 0], [0, 1]],
        [[0, 0], [3, 1], [3, 0], [0, 1]],
        [[0, 0], [1, 0], [2, 0], [3, 0]],
        [[0, 0], [1, 0], [2, 0], [3, 0], [4, 0]],
        [[np.cos(a), np.sin(a)] for a in np.arange(5) * 4 * np.pi / 5],
    ],
)
def test_crossing_and_flat_polygons_are_noted(outline):
    _, notes = cut(in_plane(outline))
    assert len(notes) == 1
    assert "crossing edges or no area" in notes[0]


def test_a_corner_that_is_not_finite_is_left_to_repair():
    points = in_plane([[0, 0], [2, 0], [np.inf, 0.5], [0, 2], [0, 1]])
    faces, notes = cut(points)
    assert faces.tolist() == [[0, 1, 2], [0, 2, 3], [0, 3, 4]]
    assert notes == ()


def test_the_limit_of_faces_applies_before_triangulation():
    with pytest.raises(MeshTooLargeError):
        triangulated(np.zeros((5, 3)), np.arange(5), np.array([5]), MeshLimits(faces=2))


def test_a_concave_polygon_with_too_many_corners_is_refused():
    teeth = np.arange(100_001)
    outline = np.concatenate([np.column_stack([teeth, teeth % 2 * 9.0]), [[1e5, -1], [0, -1]]])
    with pytest.raises(MeshReadError, match="face that is not convex"):
        cut(in_plane(outline))


PENTAGON = [[0, 0, 0], [4, 0, 0], [4, 4, 0], [1, 1, 0], [0, 4, 0]]
RING = [1, 2, 3, 4, 0]


def pentagon(kind: str) -> bytes:
    rows = "".join(f"{x} {y} {z}\n" for x, y, z in PENTAGON)
    ring = " ".join(map(str, RING))
    if kind == "off":
        return f"OFF\n5 1 0\n{rows}5 {ring}\n".encode()
    if kind == "binary off":
        return b"OFF BINARY\n" + struct.pack(">3i15f7i", 5, 1, 0, *np.ravel(PENTAGON), 5, *RING, 0)
    if kind == "obj":
        return ("".join(f"v {x} {y} {z}\n" for x, y, z in PENTAGON) + "f 2 3 4 5 1\n").encode()
    if kind == "stl":
        corners = "".join(f"vertex {x} {y} {z}\n" for x, y, z in PENTAGON)
        return f"solid\nfacet normal 0 0 1\nouter loop\n{corners}endloop\nendfacet\nendsolid\n".encode()
    head = "element vertex 5\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n"
    head += "property list uchar int vertex_indices\nend_header\n"
    if kind == "ply":
        return f"ply\nformat ascii 1.0\n{head}{rows}5 {ring}\n".encode()
    return f"ply\nformat binary_big_endian 1.0\n{head}".encode() + struct.pack(">15fB5i", *np.ravel(PENTAGON), 5, *RING)


@pytest.mark.parametrize("kind", ["off", "binary off", "obj", "ply", "binary ply"])
def test_every_format_gives_the_same_triangles(kind):
    surface = read_mesh(pentagon(kind))
    assert surface.area == pytest.approx(10)
    assert surface.report.components == 1
    expected, _ = cut(np.array(PENTAGON)[RING])
    np.testing.assert_array_equal(surface.faces, np.array(RING)[expected])
