"""Matching of pieces with their wholes, whose true correspondence is known."""

from __future__ import annotations

import numpy as np
import pytest

from tests.correspondence.bodies import bent, cut, errors, knobbly
from unbend import Surface, geodesic_distances, match, read_mesh, transfer
from unbend.correspondence.parts.bounds import crossings, least_distances
from unbend.correspondence.parts.directions import directions_of
from unbend.errors import ParameterError, UnsuitedError
from unbend.mesh.shapes import cylinder, sheet


@pytest.fixture(scope="module")
def body() -> Surface:
    return knobbly()


@pytest.fixture(scope="module")
def half(body) -> tuple[Surface, np.ndarray]:
    """A piece with .5 of the area, and the vertex of the body of each of its vertices."""
    return cut(body, body.vertices @ (0.5, 0.7, 0.3), 0.5)


@pytest.fixture(scope="module")
def matched(half, body):
    return match(half[0], body)


def test_a_piece_matches_its_whole(body, half, matched):
    assert errors(matched, body, body.vertices[half[1]]).mean() < 0.03
    assert matched.oriented
    assert not matched.ambiguous
    assert matched.residual < 0.01
    assert matched.confidence.mean() > 0.7
    assert matched.matched.all()


@pytest.mark.parametrize("share", [0.6, 0.35])
def test_place_and_order_do_not_matter(body, rotation, share):
    part, kept = cut(body, np.linalg.norm(body.vertices - (0.6, 0.4, 0.2), axis=1), share)
    order = np.random.default_rng(1).permutation(len(part.vertices))
    shuffled = Surface(part.vertices[order] @ rotation(2) + 4.0, np.argsort(order)[part.faces])
    found = match(shuffled, body)
    assert errors(found, body, body.vertices[kept[order]]).mean() < 0.04


def test_a_piece_with_holes_matches(body):
    away = np.min([np.linalg.norm(body.vertices - body.vertices[at], axis=1) for at in (5, 900, 2000)], axis=0)
    part, kept = cut(body, -away, 0.75)
    assert errors(match(part, body), body, body.vertices[kept]).mean() < 0.04


def test_a_piece_of_a_bent_body_matches(body, half):
    other = bent(body)
    found = match(half[0], other)
    assert errors(found, other, other.vertices[half[1]]).mean() < 0.05
    assert found.oriented


def test_a_piece_of_a_rolled_sheet_matches_the_flat_one():
    flat, rolled = sheet(columns=41, rows=21), cylinder(columns=41, rows=21)
    corner = flat.vertices @ (1.0, 0.6, 0.0)
    part, kept = cut(rolled, corner, 0.4)
    found = match(part, flat, part="a")
    assert found.residual < 0.01
    turned = flat.vertices.mean(axis=0) * 2 - flat.vertices
    both = [errors(found, flat, places[kept]).mean() for places in (flat.vertices, turned)]
    assert found.ambiguous or min(both) < 0.03


def test_orientation_tells_a_piece_from_its_mirror_image(body, half):
    mirrored = Surface(half[0].vertices * (1, 1, -1), half[0].faces[:, ::-1])
    right = match(mirrored, body, orientation="reverse")
    assert errors(right, body, body.vertices[half[1]]).mean() < 0.03
    assert right.oriented
    kept = match(mirrored, body)
    assert errors(kept, body, body.vertices[half[1]]).mean() > 0.1
    either = match(mirrored, body, orientation="any")
    assert errors(either, body, body.vertices[half[1]]).mean() < 0.03
    assert not either.oriented


def test_faces_without_common_sides_decide_nothing(body, half):
    faces = half[0].faces.copy()
    faces[::7] = faces[::7, ::-1]
    found = match(Surface(half[0].vertices, faces), body)
    assert not found.oriented
    assert errors(found, body, body.vertices[half[1]]).mean() < 0.05


def test_a_slightly_larger_piece_matches(body, half):
    larger = Surface(1.1 * half[0].vertices, half[0].faces)
    assert errors(match(larger, body), body, body.vertices[half[1]]).mean() < 0.03


def test_every_run_gives_the_same(body, half, matched):
    again = match(half[0], body, threads=2)
    assert np.array_equal(again.faces, matched.faces)
    assert np.array_equal(again.barycentric, matched.barycentric)


def test_vertices_without_faces_have_no_point(body, half):
    more = Surface(np.vstack([half[0].vertices, [[9.0, 9.0, 9.0]]]), half[0].faces)
    loose = Surface(np.vstack([[[9.0, 9.0, 9.0]], body.vertices]), body.faces + 1)
    found = match(more, loose, samples=100)
    assert not found.matched[-1]
    assert found.matched[:-1].all()
    places = transfer(found, loose.vertices)[:-1]
    assert np.linalg.norm(places - half[0].vertices, axis=1).mean() < 0.1


def test_a_whole_is_not_matched_to_its_piece(body, half):
    with pytest.raises(UnsuitedError, match="the piece first"):
        match(body, half[0])
    assert match(body, half[0], part="no", samples=60).matched.all()
    with pytest.raises(ParameterError, match="part must be"):
        match(half[0], body, part="b")


def test_a_surface_in_another_unit_is_no_piece(body, half):
    small = Surface(half[0].vertices / 100, half[0].faces)
    alike, apart = match(small, body, samples=60), match(small, body, samples=60, part="no")
    assert np.array_equal(alike.faces, apart.faces)


def test_least_distances_are_below_those_of_the_whole(body, half):
    part, kept = half
    points = np.arange(0, len(part.vertices), 40)
    chosen = crossings(part)
    within, away = geodesic_distances(part, points), geodesic_distances(part, chosen)
    straight = np.linalg.norm(part.vertices[chosen][:, None] - part.vertices[chosen], axis=2)
    least = least_distances(within[:, chosen], np.ascontiguousarray(away.T), straight, within)
    true = geodesic_distances(body, kept[points])[:, kept]
    assert (least <= within).all()
    spacing = 0.05 * np.sqrt(body.area)
    assert (least <= true + spacing).all()
    assert (true <= within + spacing).all()
    assert (within - least)[(within - least) > 0].size


def test_directions_turn_alike_where_a_surface_is_bent():
    flat, rolled = sheet(columns=41, rows=21), cylinder(columns=41, rows=21)
    sources = np.array([50, 400, 700])
    one, other = (directions_of(each, 1.0, geodesic_distances(each, sources)) for each in (flat, rolled))
    turns = other * one.conj()
    far = (geodesic_distances(flat, sources) > 0.1).all(axis=0)
    same = np.abs(turns.sum(axis=1))[far] / 3
    assert np.median(same) > 0.99
    reflected = np.abs((other * one).sum(axis=1))[far] / 3
    assert np.median(reflected) < 0.9


@pytest.mark.parametrize(
    ("folder", "one", "other", "share", "most"),
    [
        ("tosca5k", "david0", "david0", 0.6, 0.03),
        ("faust5k", "tr_reg_030", "tr_reg_030", 0.45, 0.03),
        ("tosca5k", "david0", "david1", 0.6, 0.05),
        ("faust5k", "tr_reg_002", "tr_reg_004", 0.6, 0.05),
    ],
)
def test_pieces_of_real_bodies_match(shared_data, folder, one, other, share, most):
    a, b = (read_mesh(shared_data / folder / f"{name}.off") for name in (one, other))
    truth = [np.loadtxt(shared_data / folder / "corres" / f"{name}.vts", dtype=int) - 1 for name in (one, other)]
    truth = [
        each if mesh.vertex_map is None else mesh.vertex_map[each] for each, mesh in zip(truth, (a, b), strict=True)
    ]
    part, kept = cut(a, geodesic_distances(a, truth[0][:1])[0], share)
    place = np.full(len(a.vertices), -1)
    place[kept] = np.arange(len(kept))
    inside = np.flatnonzero(place[truth[0]] >= 0)
    points = np.random.default_rng(0).choice(inside, 200, replace=False)
    found = match(part, b)
    images = found.vertices[place[truth[0][points]]]
    far = geodesic_distances(b, truth[1][points])[np.arange(200), images] / np.sqrt(b.area)
    assert far.mean() < most
    assert found.oriented
