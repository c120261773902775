"""Pieces and wholes in a library: stored local signatures, rankings by them, and libraries of earlier versions."""

from __future__ import annotations

import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from benchmarks.partial.cuts import piece
from tests.support.server import ply
from unbend import Library, Parameters, Surface, compute_signature
from unbend.errors import NotFoundError, ParameterError
from unbend.library import shape_rows
from unbend.library.requests import QueryRequest
from unbend.library.stored_rankings import is_packed, pack_ranking, unpack_ranking
from unbend.local.signatures import local_signatures
from unbend.mesh.shapes import ellipsoid, sphere, torus

FEW = Parameters(samples=40)
RELEASED = Path(__file__).parent / "released"

EGG, BALL, RING = ellipsoid((2.0, 1.0, 0.7)), sphere(3), torus(1.5, 0.5)


@pytest.fixture(scope="module")
def part() -> Surface:
    return piece(EGG, "disc, .45", "egg")


@pytest.fixture(scope="module")
def filled(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("filled") / "shapes.db"
    with Library(str(path)) as opened:
        for name, surface in {"egg": EGG, "ball": BALL, "ring": RING}.items():
            opened.add(ply(surface), name=name, label=name, parameters=FEW)
    return path


@pytest.fixture
def library(tmp_path, filled):
    shutil.copytree(filled.parent, tmp_path / "copy")
    with Library(str(tmp_path / "copy" / filled.name)) as opened:
        yield opened


def asked(surface: Surface, *, local: bool = True):
    return compute_signature(surface, FEW, local=local)


def test_a_piece_finds_its_whole_and_what_it_is_to_it(library, part):
    ranking = library.rank(asked(part), measure="partial")
    assert ranking.measure == "partial"
    assert ranking.shapes[0].name == ranking.classes[0].label == "egg"
    assert ranking.shapes[0].part.relation == "part"
    assert ranking.shapes[0].part.covered == pytest.approx(0.45, abs=0.01)
    assert ranking.classes[0].confidence > 0.9
    assert ranking.known is None  # no class has another member
    assert ranking.as_dict()["shapes"][0]["part"]["relation"] == "part"
    assert library.classify(asked(part), measure="partial")[0].label == "egg"


def test_a_stored_piece_is_contained_in_a_query_and_does_not_find_itself(library, part):
    stored = library.add(ply(part), name="part", parameters=FEW)
    found = {match.name: match for match in library.rank(asked(EGG), measure="partial").shapes}
    assert found["part"].part.relation == "contains"
    assert found["egg"].part.relation == "whole"
    names = [match.name for match in library.rank(stored.id, measure="partial").shapes]
    assert names[0] == "egg"
    assert "part" not in names


def test_under_the_default_an_open_query_of_closed_shapes_carries_a_warning_that_names_the_measure(library, part):
    assert "`partial`" in library.rank(asked(part, local=False)).warnings[-1]
    assert library.rank(asked(EGG, local=False)).warnings == ()
    stored = library.add(ply(part), name="part", parameters=FEW)
    assert "`partial`" in library.rank(stored.id).warnings[-1]
    for name in ("egg", "ball", "ring"):
        library.remove(next(shape.id for shape in library.page().items if shape.name == name))
    assert "nearest shape is open" in library.rank(asked(EGG, local=False)).warnings[-1]


def test_changes_removals_and_new_shapes_count_at_once(library, part):
    query = asked(part)
    egg = library.rank(query, measure="partial").shapes[0]
    library.change(egg.id, label="renamed")
    assert library.rank(query, measure="partial").classes[0].label == "renamed"
    library.remove(egg.id)
    assert {match.name for match in library.rank(query, measure="partial").shapes} == {"ball", "ring"}
    library.add(ply(EGG), name="again", label="egg", parameters=FEW)
    assert library.rank(query, measure="partial").shapes[0].name == "again"
    assert library.rank(query, measure="partial", k=1).shapes[0].name == "again"


def test_only_shapes_with_the_parameters_of_the_query_are_compared(library, part):
    assert library.rank(compute_signature(part, local=True), measure="partial").shapes == []


def test_what_measures_of_parts_need_is_said(library, part):
    with pytest.raises(ParameterError, match="without local signatures"):
        library.rank(asked(part, local=False), measure="partial")
    with pytest.raises(ParameterError, match="no classifier but nearest") as raised:
        QueryRequest("partial", "mean")
    assert raised.value.field == "classifier"
    with pytest.raises(ParameterError, match="partial_any_scale"):
        QueryRequest("partiall")


def test_local_signatures_are_stored_as_computed_and_removed_with_their_shape(library):
    with library.store.read() as connection:
        stored = shape_rows.get_locals(connection, [1])[1]
    fresh = local_signatures(EGG)
    np.testing.assert_allclose(stored.growth, fresh.growth, atol=1e-3)  # the mesh file has single precision
    library.remove(library.page().items[0].id)
    with library.store.read() as connection:
        assert shape_rows.get_locals(connection, [1]) == {}


def test_a_stored_ranking_keeps_what_the_query_is_to_each_shape(library, part):
    ranking = library.rank(asked(part), measure="partial").as_dict()
    with library.store.write() as connection:
        packed = pack_ranking(connection, ranking)
        assert is_packed(packed)
        assert not is_packed(packed | {"shapes": [[1, 0.5, "part"]]})
        assert unpack_ranking(connection, packed) == ranking


def test_a_library_of_an_earlier_version_says_what_is_missing_and_is_completed(tmp_path):
    path = tmp_path / "old.db"
    with closing(sqlite3.connect(path)) as connection:
        connection.executescript((RELEASED / "0009.sql").read_text(encoding="utf-8"))
    with Library(str(path)) as library:
        one, other = library.page().items
        with pytest.raises(NotFoundError, match="unbend complete"):
            library.rank(one.id, measure="partial")
        before = [library.signature(shape.id) for shape in (one, other)]
        assert [shape.id for shape in library.complete()] == [one.id, other.id]
        assert list(library.complete()) == []
        ranking = library.rank(one.id, measure="partial")
        assert [match.id for match in ranking.shapes] == [other.id]
        assert ranking.warnings == ()
        # The library does not know the lengths of boundaries, so no warning about open shapes is possible.
        assert library.rank(one.id).warnings == ()
        for shape, signature in zip((one, other), before, strict=True):
            np.testing.assert_array_equal(library.signature(shape.id).points, signature.points)


def test_a_ranking_counts_the_shapes_that_it_cannot_compare(library, part):
    with library.store.write() as connection:
        connection.exec_driver_sql("UPDATE local_signatures SET version = '0' WHERE signature_id = 2")
        connection.exec_driver_sql("UPDATE library_state SET revision = revision + 1")
    ranking = library.rank(asked(part), measure="partial")
    assert {match.name for match in ranking.shapes} == {"egg", "ring"}
    assert ranking.warnings == ("1 shape without local signatures was not compared: run `unbend complete` first",)


def test_a_ranking_counts_the_shapes_whose_size_is_too_different(library, part):
    tiny = Surface(1e-3 * EGG.vertices, EGG.faces)
    library.add(ply(tiny), name="tiny", parameters=FEW)
    ranking = library.rank(asked(part), measure="partial")
    assert "tiny" not in {match.name for match in ranking.shapes}
    (warning,) = ranking.warnings
    assert warning.startswith("1 shape of a very different size was not compared: ")
    assert "`partial_any_scale`" in warning
    assert library.rank(asked(part), measure="partial_any_scale").warnings == ()
