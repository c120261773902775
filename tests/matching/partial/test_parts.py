"""Pieces and wholes of real meshes, compared by their local signatures."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.partial.cuts import piece
from unbend import Surface, geodesic_distances, read_mesh
from unbend.local.signatures import LocalSignatures, local_signatures
from unbend.matching.partial import PartSearch, compare_parts, profiles_of, search_parts
from unbend.matching.partial.calibration import SLACK, unfamiliarity
from unbend.matching.partial.scanning import scan_parts, scan_shifted

NAMES = ("cat0", "cat1", "dog0", "horse0", "centaur0", "david0")


@pytest.fixture(scope="module")
def surfaces(shared_data) -> dict[str, Surface]:
    return {name: read_mesh(shared_data / "tosca5k" / f"{name}.off") for name in NAMES}


@pytest.fixture(scope="module")
def wholes(surfaces) -> dict[str, LocalSignatures]:
    return {name: local_signatures(surface) for name, surface in surfaces.items()}


@pytest.fixture(scope="module")
def part(surfaces) -> Surface:
    return piece(surfaces["cat1"], "disc, .45", "cat1")


@pytest.fixture(scope="module")
def cut(part) -> LocalSignatures:
    return local_signatures(part)


def search(query: LocalSignatures, shapes: dict[str, LocalSignatures], **options) -> tuple[list[str], PartSearch]:
    """Return the names of the shapes, the nearest first, and the search."""
    every = list(shapes.values())
    found = search_parts(query, [profiles_of(each) for each in every], lambda rows: [every[r] for r in rows], **options)
    return [list(shapes)[row] for row in np.argsort(found.distances)], found


def test_a_piece_is_found_on_its_own_whole_then_on_another_pose_of_it(cut, wholes):
    names, found = search(cut, wholes)
    assert names[:2] == ["cat1", "cat0"]
    own = found.comparisons[1]
    assert own.relation == "part"
    assert own.covered == pytest.approx(0.45, abs=0.01)
    assert own.matched > 0.95
    assert own.residual < 0.05 * np.sqrt(wholes["cat1"].area)
    assert own.scale == 1.0
    assert np.linalg.norm(np.subtract(own.place, own.centre)) < 0.1 * np.sqrt(wholes["cat1"].area)  # same coordinates


def test_a_piece_of_a_stranger_is_less_familiar_than_a_piece_of_the_class(cut, surfaces, wholes):
    stranger = local_signatures(piece(surfaces["horse0"], "disc, .45", "horse0"))
    cat, pose, dog = (wholes[name] for name in ("cat1", "cat0", "dog0"))
    ratios = []
    for query in (cut, stranger):
        found = compare_parts(query, cat)
        next_class = compare_parts(query, dog).distance
        ratios.append(unfamiliarity(query, found, cat, [pose], next_class))
        assert unfamiliarity(query, found, cat, [], next_class) is None
    assert ratios[0] <= SLACK < ratios[1]


def test_a_whole_contains_its_piece(cut, wholes):
    found = compare_parts(wholes["cat1"], cut)
    assert found.relation == "contains"
    assert found.covered == pytest.approx(0.45, abs=0.01)
    assert found.distance == compare_parts(cut, wholes["cat1"]).distance


def test_two_poses_are_wholes_and_a_shape_is_at_no_distance_from_itself(wholes):
    cat, pose = wholes["cat0"], wholes["cat1"]
    assert compare_parts(cat, pose).relation == "whole"
    assert compare_parts(cat, cat).distance == 0.0
    assert compare_parts(cat, pose).distance < compare_parts(cat, wholes["horse0"]).distance


@pytest.mark.parametrize("factor", [0.37, 25.4])
def test_at_any_scale_a_piece_in_another_unit_is_found_with_its_scale(part, wholes, factor):
    query = local_signatures(Surface(part.vertices * factor, part.faces))
    names, found = search(query, wholes, any_scale=True)
    assert names[0] == "cat1"
    assert found.comparisons[1].scale * factor == pytest.approx(1.0, rel=0.04)
    assert found.comparisons[1].residual < factor * 0.06 * np.sqrt(wholes["cat1"].area)
    assert search(query, wholes)[1].distances[1] > 1.1 * found.distances[1]


def test_shapes_behind_the_short_list_keep_their_order_and_stay_behind_it(cut, wholes):
    scanned = scan_parts(profiles_of(cut), [profiles_of(each) for each in wholes.values()])
    _, found = search(cut, wholes, shortlist=2)
    assert set(found.comparisons) == set(np.argsort(scanned)[:2].tolist())
    behind = np.argsort(scanned)[2:]
    assert (np.diff(found.distances[behind]) >= 0).all()
    assert found.distances[behind].min() >= max(each.distance for each in found.comparisons.values())


def test_a_search_does_not_depend_on_the_number_of_threads(cut, wholes):
    one, two = (search(cut, wholes, any_scale=True, threads=threads)[1] for threads in (1, 2))
    np.testing.assert_array_equal(one.distances, two.distances)
    np.testing.assert_array_equal(one.scanned, two.scanned)


def test_the_smaller_a_piece_is_taken_to_be_the_fewer_of_its_rings_the_whole_has(cut, wholes):
    query, whole = profiles_of(cut), profiles_of(wholes["cat1"])
    shifts = np.array([[0], [-4], [-8], [-40]])
    distances, common = scan_shifted(query, [whole], shifts)
    assert (np.diff(common[:, 0]) < 0).all()
    assert common[0] > 0.5  # at the right scale, most rings
    assert common[3] == 0
    assert np.isfinite(distances[:2]).all()
    assert np.isinf(distances[3])
    turned, same = scan_shifted(whole, [query], -shifts)
    np.testing.assert_array_equal(turned, distances)
    np.testing.assert_array_equal(same, common)


def test_an_empty_gallery_has_no_results(cut):
    found = search_parts(cut, [], lambda _rows: [], any_scale=True)
    assert len(found.distances) == 0
    assert not found.comparisons


def test_a_piece_that_is_too_small_for_circles_is_compared_without_an_error(surfaces, wholes):
    cat = surfaces["cat0"]
    distances = geodesic_distances(cat, 0)[0]
    faces = cat.faces[(distances[cat.faces] < 0.05 * np.sqrt(cat.area)).all(axis=1)]
    tiny = local_signatures(Surface(cat.vertices, faces))
    for any_scale in (False, True):
        names, found = search(tiny, wholes, any_scale=any_scale)
        assert len(names) == len(wholes)
        assert not np.isnan(found.distances).any()
