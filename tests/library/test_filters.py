"""Searches among some shapes only, in each database, and by each way of searching."""

from __future__ import annotations

import pytest

from tests.support.server import small_mesh
from unbend import Library, Parameters, compute_signature, read_mesh
from unbend.errors import ParameterError, VectorsMissingError
from unbend.library.search.nearest_classes import FROM_CANDIDATES
from unbend.results.rankings import Ranking

FEW = Parameters(samples=30)
METADATA = [
    {"site": "north", "year": 2020, "whole": True, "note": None},
    {"site": "south", "year": 2021, "whole": False},
    {"site": "north", "year": 2021.0, "nested": {"site": "south"}},
    {"year": "2021", "whole": 1, "note": ""},
    {},
    {"site": "north", "list": ["south"]},
]


@pytest.fixture(scope="module")
def signatures():
    return [compute_signature(read_mesh(small_mesh(number)), FEW) for number in range(len(METADATA))]


def fill(library: Library) -> None:
    for number, metadata in enumerate(METADATA):
        library.add(small_mesh(number), name=str(number), label="ab"[number % 2], metadata=metadata, parameters=FEW)


@pytest.fixture(scope="module")
def filled(database, tmp_path_factory, request):
    """A library in each database, which no test changes."""
    url = str(tmp_path_factory.mktemp("filters") / "library.db")
    if database == "postgresql":
        url = request.getfixturevalue("postgres").copy(request.getfixturevalue("empty_postgres_library"))
    with Library(url) as library:
        fill(library)
        yield library


def named(ranking: Ranking) -> set[str]:
    return {shape.name for shape in ranking.shapes}


@pytest.mark.parametrize(
    ("metadata", "names"),
    [
        ({"site": "north"}, "025"),
        ({"site": "south"}, "1"),
        ({"year": 2021}, "12"),
        ({"year": "2021"}, "3"),
        ({"whole": True}, "0"),
        ({"whole": False}, "1"),
        ({"whole": 1}, "3"),
        ({"note": None}, "0"),
        ({"note": ""}, "3"),
        ({"site": "north", "year": 2020}, "0"),
        ({"list": "south"}, ""),
        ({"none": "x"}, ""),
        ({}, "012345"),
        ({"quote\"d '$.key": 1}, ""),
    ],
)
def test_only_shapes_with_these_members_are_ranked(filled, signatures, metadata, names):
    assert named(filled.rank(signatures[0], metadata=metadata)) == set(names)


@pytest.mark.parametrize("measure", ["spectrum", "moments", "hausdorff"])
@pytest.mark.parametrize("classifier", ["nearest", "vote", "mean"])
def test_only_shapes_of_a_class_are_ranked_and_only_that_class(filled, signatures, measure, classifier):
    ranking = filled.rank(signatures[0], measure=measure, classifier=classifier, label="b")
    assert named(ranking) == set("135")
    assert [match.label for match in ranking.classes] == ["b"]
    assert ranking.exact
    stored = filled.rank(
        ranking.shapes[0].id, measure=measure, classifier=classifier, label="b", metadata={"site": "north"}
    )
    assert named(stored) == set("5") - {ranking.shapes[0].name}


def test_a_filter_is_one_of_pieces_too(filled):
    surface = read_mesh(small_mesh(0))
    assert len(named(filled.rank((surface.vertices, surface.faces), measure="partial", label="a", parameters=FEW))) == 3


def test_a_search_cannot_ask_for_arrays_and_objects(filled, signatures):
    for value in ([1], {"a": 1}):
        with pytest.raises(ParameterError, match="array or object 'x'"):
            filled.rank(signatures[0], metadata={"x": value})


def test_the_database_and_the_index_in_memory_give_the_same_answers(library, signatures, url, database):
    fill(library)
    if database == "sqlite":
        with pytest.raises(ParameterError, match="search"):
            Library(url, search="disk")
        with pytest.raises(VectorsMissingError, match="SQLite"):
            library.search.prepare_vectors()
        return
    with Library(url, search="database") as other:
        with pytest.raises(VectorsMissingError):
            other.rank(signatures[0])
        other.search.prepare_vectors()
        assert other.search.measure_recall() == 1.0
        for options in (
            {}, {"label": "a"}, {"metadata": {"site": "north"}}, {"exact": True}, {"k": 2}, {"measure": "hausdorff"},
            {"classifier": "mean"}, {"classifier": "vote"}, {"measure": "moments"},
        ):  # fmt: skip
            for query in (signatures[1], library.page().items[1].id):
                expected, found = library.rank(query, **options), other.rank(query, **options)
                assert [match.id for match in found.shapes] == [match.id for match in expected.shapes]
                assert found.known == expected.known
                assert [(each.label, round(each.confidence, 5)) for each in found.classes] == [
                    (each.label, round(each.confidence, 5)) for each in expected.classes
                ]
        removed = library.page().items[2].id
        library.remove(removed)
        library.add(small_mesh(9), name="9", parameters=FEW)
        assert named(other.rank(signatures[0], k=20)) == named(library.rank(signatures[0], k=20)) == set("013459")
    assert {"nearest", "vote"} == FROM_CANDIDATES
