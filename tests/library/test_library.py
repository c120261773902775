"""The library on a real SQLite file: adding, finding, ranking and removing shapes."""

from __future__ import annotations

import contextlib
import dataclasses
import sqlite3

import numpy as np
import pytest
from sqlalchemy import insert, select

from tests.support.server import DAMAGED, ply, small_mesh, two_rings
from unbend import Library, MeshPolicy, Parameters, compare, compute_signature, embed, read_mesh
from unbend.errors import MeshGeometryError, MeshReadError, NotFoundError, ParameterError, UnsuitedError
from unbend.library.search import overview
from unbend.library.shape_rows import MAX_PAGE
from unbend.library.storage import schema
from unbend.matching.classification import CLASSIFIERS
from unbend.matching.measures import MEASURES, VECTOR_MEASURES
from unbend.matching.rerank import SHORTLIST
from unbend.mesh.shapes import cylinder, s_bend, sheet, sphere, spiral, torus

FEW = Parameters(samples=40)
NOTHING = {"measure": "spectrum", "classes": [], "shapes": [], "known": None, "warnings": []}
GRID = {"columns": 12, "rows": 6}
BENT = {"flat": sheet(**GRID), "rolled": cylinder(**GRID), "wound": spiral(**GRID)}
ROUND = {"ball": sphere(subdivisions=1), "marble": sphere(subdivisions=2)}

KINDS = 6  # number of descriptors of a signature


def fill(library: Library) -> dict[str, str]:
    """Add three bent sheets, two spheres and an unlabelled torus; return their ids by name."""
    members = [(name, surface, "sheet") for name, surface in BENT.items()]
    members += [(name, surface, "sphere") for name, surface in ROUND.items()]
    members += [("ring", torus(columns=12, rows=8), None)]
    return {
        name: library.add(ply(surface), name=name, label=label, parameters=FEW).id for name, surface, label in members
    }


def tables(path) -> dict[str, int]:
    """Return the number of rows of each table of a library's file."""
    connection = sqlite3.connect(path)
    try:
        names = ("shapes", "signatures", "descriptors", "meshes", "jobs")
        return {name: connection.execute(f"SELECT count(*) FROM {name}").fetchone()[0] for name in names}  # noqa: S608
    finally:
        connection.close()


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    """A library that no test changes, and the ids of its shapes by name."""
    with Library(str(tmp_path_factory.mktemp("filled") / "library.db")) as opened:
        yield opened, fill(opened)


def test_an_added_shape_is_returned_with_all_its_fields(library):
    data = ply(torus(columns=12, rows=8))
    record = library.add(data, name="ring", label="torus", metadata={"scanner": "A", "n": [1, None]}, parameters=FEW)
    assert library.get(record.id) == record
    assert (record.name, record.label, record.metadata) == ("ring", "torus", {"scanner": "A", "n": [1, None]})
    assert (record.size, record.parameters) == (len(data), FEW)
    assert record.area == pytest.approx(read_mesh(data).area)
    assert record.report["file_type"] == "ply"
    assert record.created_at.tzinfo is not None
    assert library.mesh(record.id) == data
    assert len(library) == 1


def test_a_shape_added_by_path_is_named_after_its_file(library, tmp_path):
    (tmp_path / "my torus.v2.ply").write_bytes(small_mesh(0))
    assert library.add(tmp_path / "my torus.v2.ply", parameters=FEW).name == "my torus.v2"
    assert library.add(small_mesh(1), parameters=FEW).name == "unnamed"


def test_a_stored_signature_equals_the_computed_one(library):
    data = small_mesh(0)
    parameters = Parameters(samples=30, dimensions=4, method="classical", update="planar", scaling="box")
    computed = compute_signature(read_mesh(data), parameters)
    read = library.signature(library.add(data, parameters=parameters).id)
    for field in ("points", "faces", "samples", "weights"):
        np.testing.assert_array_equal(getattr(read, field), getattr(computed, field), strict=True)
    assert set(read.descriptors) == set(computed.descriptors)
    for name, vector in computed.descriptors.items():
        np.testing.assert_array_equal(read.descriptors[name], vector, strict=True)
    for field in ("scale", "stress", "asymmetry", "parameters", "version"):
        assert getattr(read, field) == getattr(computed, field)


def test_a_repeated_mesh_with_equal_parameters_is_stored_once(library, path):
    first = library.add(small_mesh(0), name="first", label="a", parameters=FEW)
    again = library.add(small_mesh(0), name="again", label="b", parameters=FEW)
    assert again == first
    other = library.add(small_mesh(0), parameters=Parameters(samples=41))
    assert other.id != first.id
    assert tables(path) == {
        "shapes": 2,
        "signatures": 2,
        "descriptors": 2 * KINDS,
        "meshes": 1,
        "jobs": 0,
    }


def test_a_mesh_read_by_another_policy_is_another_comparable_shape(library, path):
    data = ply(two_rings(0))
    largest = library.add(data, parameters=FEW)
    bridged = library.add(data, parameters=FEW, policy=MeshPolicy(components="bridge"))
    assert library.add(data, parameters=FEW, policy=MeshPolicy(components="bridge")) == bridged
    assert largest.policy == MeshPolicy()
    assert library.get(bridged.id).policy == MeshPolicy(components="bridge")
    assert bridged.area > 1.05 * largest.area
    assert [match.id for match in library.nearest(largest.id)] == [bridged.id]
    assert library.nearest(largest.id)[0].distance > 0
    assert tables(path) == {
        "shapes": 2,
        "signatures": 2,
        "descriptors": 2 * KINDS,
        "meshes": 1,
        "jobs": 0,
    }
    library.remove(largest.id)
    assert library.mesh(bridged.id) == data


def test_a_mesh_refused_by_its_policy_is_not_stored(library, path):
    with pytest.raises(MeshGeometryError, match="2 components"):
        library.add(ply(two_rings(0)), policy=MeshPolicy(components="error"))
    assert set(tables(path).values()) == {0}


def test_a_damaged_mesh_is_not_stored(library, path):
    with pytest.raises(MeshReadError, match="ends early"):
        library.add(DAMAGED)
    assert set(tables(path).values()) == {0}


def test_pages_contain_every_shape_once_in_order_of_addition(library):
    ids = [library.add(small_mesh(number), parameters=FEW).id for number in range(5)]
    seen, cursor, sizes = [], None, []
    while True:
        page = library.page(cursor=cursor, limit=2)
        seen += [record.id for record in page.items]
        sizes.append(len(page.items))
        cursor = page.next_cursor
        if cursor is None:
            break
    assert seen == ids
    assert sizes == [2, 2, 1]
    assert library.page(limit=5).next_cursor is None


def test_the_next_page_is_stable_when_shapes_are_added_and_removed(library):
    ids = [library.add(small_mesh(number), parameters=FEW).id for number in range(4)]
    first = library.page(limit=2)
    library.remove(ids[0])
    last = library.add(small_mesh(9), parameters=FEW).id
    rest = library.page(cursor=first.next_cursor)
    assert [record.id for record in rest.items] == [ids[2], ids[3], last]


def test_pages_can_be_filtered_by_label(filled):
    library, ids = filled
    first = library.page(label="sheet", limit=2)
    rest = library.page(label="sheet", limit=2, cursor=first.next_cursor)
    assert [record.id for record in first.items + rest.items] == [ids[name] for name in BENT]
    assert rest.next_cursor is None
    assert library.page(label="none of these").items == []


def test_a_page_has_a_maximal_size(library):
    record = library.add(small_mesh(0), parameters=FEW)
    with library.store.write() as connection:
        insert_many(connection, record.id, MAX_PAGE)
    page = library.page(limit=10 * MAX_PAGE)
    assert len(page.items) == MAX_PAGE
    assert len(library.page(cursor=page.next_cursor, limit=10 * MAX_PAGE).items) == 1


def insert_many(connection, shape_id: str, count: int) -> None:
    """Copy the row of a shape, which is faster than computing shapes."""
    signature, shape = (
        dict(connection.execute(select(table)).mappings().one()) for table in (schema.signatures, schema.shapes)
    )
    assert shape["id"] == shape_id
    for number in range(count):
        copy = signature | {"id": 1000 + number, "version": f"copy {number}"}
        connection.execute(insert(schema.signatures).values(**copy))
        copy = shape | {"seq": 1000 + number, "id": f"copy {number}", "signature_id": 1000 + number}
        connection.execute(insert(schema.shapes).values(**copy))


@pytest.mark.parametrize("cursor", ["", "x", "-1", "1.5", "9" * 30, "1 OR 1"])
def test_an_invalid_cursor_raises_parameter_error(library, cursor):
    with pytest.raises(ParameterError, match="cursor"):
        library.page(cursor=cursor)


@pytest.mark.parametrize("limit", [0, -1, -1000])
def test_a_page_of_less_than_one_shape_is_refused(filled, limit):
    with pytest.raises(ParameterError, match="limit"):
        filled[0].page(limit=limit)


def test_name_label_and_metadata_can_be_changed_and_nothing_else(library):
    record = library.add(small_mesh(0), name="a", label="b", metadata={"c": 1}, parameters=FEW)
    first = library.change(record.id, label=None)
    assert first == dataclasses.replace(record, label=None, updated_at=first.updated_at, revision=first.revision)
    changed = library.change(record.id, name="x", metadata={"y": [2]})
    edited = {"name": "x", "metadata": {"y": [2]}, "updated_at": changed.updated_at, "revision": changed.revision}
    assert changed == dataclasses.replace(first, **edited)
    assert record.updated_at < first.updated_at < changed.updated_at
    assert record.revision < first.revision < changed.revision
    assert library.get(record.id) == changed
    assert library.change(record.id) == changed
    with pytest.raises(ParameterError, match="sha256"):
        library.change(record.id, sha256="0")


def test_a_shape_cannot_lose_its_name(library):
    record = library.add(small_mesh(0), name="a", parameters=FEW)
    with pytest.raises(ParameterError, match="name"):
        library.change(record.id, name=None)


def test_metadata_that_json_cannot_represent_is_refused(library):
    for value in (object(), float("nan"), {1, 2}):
        with pytest.raises(ParameterError, match="metadata"):
            library.add(small_mesh(0), metadata={"value": value}, parameters=FEW)


def test_removal_deletes_the_mesh_file_unless_another_shape_needs_it(library, path):
    first = library.add(small_mesh(0), parameters=FEW)
    second = library.add(small_mesh(0), parameters=Parameters(samples=41))
    library.remove(first.id)
    assert tables(path) == {"shapes": 1, "signatures": 1, "descriptors": KINDS, "meshes": 1, "jobs": 0}
    assert library.mesh(second.id) == small_mesh(0)
    library.remove(second.id)
    assert set(tables(path).values()) == {0}
    assert library.add(small_mesh(0), parameters=FEW).id not in {first.id, second.id}


@pytest.mark.parametrize("call", ["get", "mesh", "signature", "remove", "rank", "nearest", "classify"])
def test_an_unknown_shape_raises_not_found(filled, call):
    with pytest.raises(NotFoundError, match="nobody"):
        getattr(filled[0], call)("nobody")


def test_changing_an_unknown_shape_raises_not_found(filled):
    for changes in ({"name": "x"}, {}):
        with pytest.raises(NotFoundError, match="no shape nobody"):
            filled[0].change("nobody", **changes)


def test_labels_are_counted_without_unlabelled_shapes(filled):
    assert filled[0].labels() == {"sheet": 3, "sphere": 2}
    assert len(filled[0]) == 6


@pytest.mark.parametrize("measure", VECTOR_MEASURES)
def test_shapes_are_ranked_by_the_distance_of_compare(filled, measure):
    library, ids = filled
    query = compute_signature(torus(columns=14, rows=7), FEW)
    ranking = library.rank(query, measure=measure, k=100)
    expected = {name: compare(query, library.signature(id_), measure) for name, id_ in ids.items()}
    assert [match.name for match in ranking.shapes] == sorted(expected, key=expected.__getitem__)
    for match in ranking.shapes:
        assert match.distance == pytest.approx(expected[match.name])
        assert match.id == ids[match.name]
    nearest = {
        "sheet": min(expected[name] for name in BENT),
        "sphere": min(expected[name] for name in ROUND),
    }
    assert {match.label: match.distance for match in ranking.classes} == pytest.approx(nearest)
    assert [match.distance for match in ranking.classes] == sorted(nearest.values())


def test_k_limits_the_shapes_but_not_the_classes(filled):
    library, ids = filled
    whole = library.rank(ids["flat"], k=100)
    for k in (1, 3, 5):
        ranking = library.rank(ids["flat"], k=k)
        assert ranking.shapes == whole.shapes[:k]
        assert ranking.classes == whole.classes
    assert library.nearest(ids["flat"], 2) == whole.shapes[:2]
    assert library.classify(ids["flat"]) == whole.classes
    for k in (0, -1):
        with pytest.raises(ParameterError, match="k must be"):
            library.rank(ids["flat"], k=k)


def test_a_query_by_id_excludes_the_shape_but_a_query_by_its_signature_finds_it(filled):
    library, ids = filled
    assert sorted(match.id for match in library.nearest(ids["flat"], 100)) == sorted(set(ids.values()) - {ids["flat"]})
    found = library.nearest(library.signature(ids["flat"]), 1)[0]
    assert (found.id, found.distance) == (ids["flat"], 0.0)


def test_a_bent_sheet_is_recognised_as_a_sheet_and_a_torus_as_unknown(filled):
    library, ids = filled
    rankings = [library.rank(ids[name]) for name in ("flat", "rolled", "wound")]
    assert {ranking.classes[0].label for ranking in rankings} == {"sheet"}
    assert sum(ranking.known is True for ranking in rankings) >= 2  # at least the two that are nearest to each other
    assert library.rank(ids["ring"]).known is False


def test_known_is_none_if_the_nearest_class_has_fewer_than_two_members(library):
    query = compute_signature(sphere(subdivisions=1), FEW)
    assert library.rank(query).as_dict() == {
        "measure": "spectrum",
        "classes": [],
        "shapes": [],
        "known": None,
        "warnings": [],
        "exact": True,
    }
    library.add(small_mesh(0), parameters=FEW)
    unlabelled = library.rank(query)
    assert (unlabelled.classes, len(unlabelled.shapes), unlabelled.known) == ([], 1, None)
    library.add(ply(sphere(subdivisions=2)), label="sphere", parameters=FEW)
    assert library.rank(query).known is None


def test_a_lone_shape_has_no_neighbours(library):
    record = library.add(small_mesh(0), label="a", parameters=FEW)
    assert library.rank(record.id).as_dict() == {
        "measure": "spectrum",
        "classes": [],
        "shapes": [],
        "known": None,
        "warnings": [],
        "exact": True,
    }


def test_shapes_with_other_parameters_are_not_found(library):
    few = library.add(small_mesh(0), label="few", parameters=FEW)
    many = library.add(small_mesh(0), label="many", parameters=Parameters(samples=41))
    other = library.add(small_mesh(1), label="many", parameters=Parameters(samples=41))
    assert library.nearest(few.id) == []
    assert [match.id for match in library.nearest(many.id)] == [other.id]
    query = compute_signature(read_mesh(small_mesh(5)), FEW)
    assert [match.id for match in library.nearest(query)] == [few.id]


def test_an_unknown_measure_is_refused(filled):
    library, ids = filled
    with pytest.raises(ParameterError, match="volume"):
        library.rank(ids["flat"], measure="volume")
    with pytest.raises(ParameterError, match="volume"):
        library.evaluate("volume")


def test_evaluation_is_leave_one_out_over_labelled_shapes(filled):
    metrics, reported = filled[0].evaluate(parameters=FEW), filled[0].evaluation(parameters=FEW)
    assert metrics == reported.metrics
    assert (metrics.nn, metrics.ft, metrics.map) == (1.0, 1.0, 1.0)
    assert (reported.queries, reported.confusion.labels) == (5, ("sheet", "sphere"))
    assert reported.confusion.counts == ((3, 0), (0, 2))


def test_the_evaluation_of_a_large_library_uses_a_sample_of_queries(filled, monkeypatch):
    monkeypatch.setattr(overview, "_PAIRS", 15)
    reported = filled[0].evaluation(parameters=FEW)
    assert (reported.queries, reported.metrics.nn) == (3, 1.0)


def test_the_map_places_every_shape_by_signature_and_by_original_surface(filled):
    library, ids = filled
    found = library.map(parameters=FEW)
    assert {(item.name, item.label) for item in found.items} == {
        *((name, "sheet") for name in BENT), *((name, "sphere") for name in ROUND), ("ring", None),
    }  # fmt: skip
    assert {item.id for item in found.items} == set(ids.values())
    places = {item.name: np.array(item.point) for item in found.items}
    originals = {item.name: np.array(item.original) for item in found.items}

    def apart(of, a, b):
        return float(np.linalg.norm(of[a] - of[b]))

    exact = compare(library.signature(ids["flat"]), library.signature(ids["ball"]))
    assert apart(places, "flat", "ball") == pytest.approx(exact, rel=0.1)
    bent, unbent = (apart(of, "flat", "wound") / apart(of, "flat", "ball") for of in (originals, places))
    assert unbent < 0.3
    assert bent > 0.5
    assert 0 <= found.stress < 0.05
    assert 0 <= found.original_stress < 0.05


def test_the_map_of_squared_distances_equals_section_2_3(filled):
    """[D_M]_ij = |M_i - M_j|^2, of moments (section 2.3)."""
    library, ids = filled
    found = library.map("moments", parameters=FEW, distance="squared_l2")
    names = list(ids)
    moments = np.array([library.signature(ids[name]).moments for name in names])
    wanted = ((moments[:, None] - moments[None]) ** 2).sum(axis=2)
    assert found.stress == pytest.approx(embed(wanted, 2).stress, rel=0.01, abs=1e-4)
    places = {item.name: np.array(item.point) for item in found.items}
    apart = np.array([[np.linalg.norm(places[a] - places[b]) for b in names] for a in names])
    raw = ((apart - wanted) ** 2).sum() / (wanted**2).sum()
    assert raw == pytest.approx(found.stress, rel=0.01, abs=1e-4)
    with pytest.raises(ParameterError, match="distance must be one of l1, squared_l2"):
        library.map("moments", parameters=FEW, distance="l2")


def test_a_map_respects_its_limit_and_follows_changes(library):
    ids = fill(library)
    few = library.map("moments", parameters=FEW, dimensions=3, limit=4)
    assert (len(few.items), few.count, len(few.items[0].point)) == (4, 6, 3)
    library.remove(ids["ring"])
    library.change(ids["ball"], name="orb", label=None)
    found = library.map("moments", parameters=FEW)
    assert (found.count, {item.name for item in found.items} & {"ring", "ball", "orb"}) == (5, {"orb"})
    assert library.map().items == []
    for wrong in ({"limit": 0}, {"dimensions": 0}, {"measure": "volume"}, {"measure": "rigid"}):
        with pytest.raises(ParameterError, match=str(next(iter(wrong.values())))):
            library.map(**wrong)


@pytest.mark.parametrize("classifier", CLASSIFIERS)
def test_every_classifier_recognises_a_bent_sheet(filled, classifier):
    library, _ = filled
    query = compute_signature(s_bend(**GRID), FEW)
    ranked = library.rank(query, classifier=classifier)
    assert ranked.classes[0].label == "sheet"
    assert sum(match.confidence for match in ranked.classes) == pytest.approx(1.0)
    assert library.classify(query, classifier=classifier) == ranked.classes


@pytest.fixture(scope="module")
def in_both_orders(tmp_path_factory):
    """Two libraries of the same shapes, which were added in opposite orders."""
    members = [*BENT.values(), *ROUND.values(), torus(columns=12, rows=8), torus(columns=10, rows=8)]
    labels = ["sheet"] * len(BENT) + ["sphere"] * len(ROUND) + ["torus"] * 2
    shapes = list(enumerate(zip(members, labels, strict=True)))
    with contextlib.ExitStack() as opened:
        libraries = [opened.enter_context(Library(str(tmp_path_factory.mktemp("order") / "a.db"))) for _ in range(2)]
        for library, ordered in zip(libraries, (shapes, shapes[::-1]), strict=True):
            for name, (surface, label) in ordered:
                library.add(ply(surface), name=str(name), label=label, parameters=FEW)
        yield libraries


@pytest.mark.parametrize("measure", MEASURES)
def test_answers_do_not_depend_on_the_order_of_the_library(in_both_orders, measure):
    query = compute_signature(s_bend(**GRID), FEW)
    found = []
    for library in in_both_orders:
        reported = [library.rank(query, measure=measure, classifier=classifier, k=20) for classifier in CLASSIFIERS]
        found.append([([(m.name, m.distance) for m in of.shapes], of.known) for of in reported])
        found[-1] += [[(c.label, pytest.approx(c.confidence, rel=1e-9)) for c in of.classes] for of in reported]
    assert found[0] == found[1]


def test_an_unknown_classifier_is_refused(filled):
    library, ids = filled
    with pytest.raises(ParameterError, match="oracle"):
        library.rank(ids["flat"], classifier="oracle")


@pytest.mark.parametrize("measure", ["rigid", "hausdorff"])
def test_pair_measures_reorder_the_nearest_shapes(filled, measure):
    library, ids = filled
    query = compute_signature(s_bend(**GRID), FEW)
    plain, anew = library.rank(query, k=5), library.rank(query, measure=measure, k=5)
    assert (anew.measure, anew.classes, anew.known) == (measure, plain.classes, plain.known)
    expected = sorted((compare(query, library.signature(match.id), measure), match.id) for match in plain.shapes)
    assert [(match.distance, match.id) for match in anew.shapes] == expected
    stored = library.rank(ids["flat"], measure=measure, k=2)
    assert ids["flat"] not in [match.id for match in stored.shapes]
    with pytest.raises(ParameterError, match="at most 100"):
        library.rank(query, measure=measure, k=101)


def test_a_pair_measure_chooses_the_nearest_of_the_whole_short_list(filled):
    library, ids = filled
    changed = 0
    for name in ids:
        for measure in ("rigid", "hausdorff"):
            (first,) = library.rank(ids[name], measure=measure, k=1).shapes
            assert first == library.rank(ids[name], measure=measure, k=SHORTLIST).shapes[0]
            changed += first.id != library.rank(ids[name], k=1).shapes[0].id
    assert changed


def test_an_evaluation_without_labelled_shapes_is_refused(filled, library):
    with pytest.raises(ParameterError, match="no shape has the parameters"):
        filled[0].evaluate()
    with pytest.raises(ParameterError, match="two members"):
        library.evaluate(parameters=FEW)


def test_the_index_is_correct_after_every_change(library, path):
    query = compute_signature(sphere(subdivisions=1), FEW)

    def agrees() -> None:
        with Library(str(path)) as fresh:
            for measure in ("spectrum", "moments"):
                assert library.rank(query, measure=measure, k=100) == fresh.rank(query, measure=measure, k=100)

    agrees()
    ids = fill(library)
    agrees()
    assert len(library.nearest(query, 100)) == 6
    library.change(ids["ball"], label="globe", name="globe-1")
    agrees()
    assert library.rank(query).shapes[0].name == "globe-1"
    assert library.rank(query).classes[0].label == "globe"
    library.remove(ids["ball"])
    agrees()
    assert len(library.nearest(query, 100)) == 5
    library.remove(ids["ring"])  # the shape added last, whose sequence number must not be reused
    library.add(small_mesh(3), name="new", parameters=FEW)
    agrees()
    assert "new" in [match.name for match in library.nearest(query, 100)]


def test_two_libraries_on_one_file_see_each_others_changes(path):
    query = compute_signature(sphere(subdivisions=1), FEW)
    with Library(str(path)) as one, Library(str(path)) as two:
        assert one.nearest(query) == two.nearest(query) == []
        added = one.add(small_mesh(0), name="a", parameters=FEW)
        assert [match.name for match in two.nearest(query)] == ["a"]
        two.change(added.id, name="b")
        assert [match.name for match in one.nearest(query)] == ["b"]
        second = two.add(small_mesh(1), parameters=FEW)
        one.remove(added.id)
        assert [match.id for match in two.nearest(query)] == [second.id]
        assert two.add(small_mesh(1), parameters=FEW) == one.get(second.id)


def test_threads_can_add_and_query_at_the_same_time(library):
    from concurrent.futures import ThreadPoolExecutor

    query = compute_signature(sphere(subdivisions=1), FEW)

    def work(number: int) -> int:
        library.add(small_mesh(number % 6), name=str(number % 6), parameters=FEW)
        return len(library.nearest(query, 100))

    with ThreadPoolExecutor(6) as pool:
        counts = list(pool.map(work, range(18)))
    assert len(library) == 6
    assert min(counts) >= 1
    assert sorted(match.name for match in library.nearest(query, 100)) == list("012345")


def test_a_reopened_library_gives_the_same_answers(path):
    with Library(str(path)) as library:
        ids = fill(library)
        before = library.rank(ids["flat"])
    with Library(f"sqlite:///{path}") as library:
        assert library.rank(ids["flat"]) == before
        assert len(library) == 6


def test_an_answer_without_shapes_says_which_parameters_they_have(filled, tmp_path):
    library, ids = filled
    reason = "no shape has the parameters of the query, samples=300: 6 shapes have samples=40"
    mesh = torus(columns=12, rows=8)
    for warnings in (
        library.rank(mesh).warnings,
        library.rank(mesh, measure="partial").warnings,
        library.rank(mesh, measure="rigid").warnings,
        library.map().warnings,
    ):
        assert any(each.startswith(reason) for each in warnings), warnings
    with pytest.raises(UnsuitedError, match=reason) as raised:
        library.evaluation()
    assert "parameters of the shapes" in raised.value.advice
    assert library.map(parameters=FEW).warnings == ()
    assert library.rank(ids["flat"]).warnings == ()
    with Library(str(tmp_path / "own.db")) as other:
        assert (other.rank(mesh, parameters=FEW).warnings, other.map().warnings) == ((), ())
        first = other.add(mesh, parameters=FEW).id
        assert other.rank(first).warnings == ()  # there is no other shape at all
        other.add(sheet(**GRID), parameters=Parameters(samples=30, seed=2))
        other.add(sheet(**GRID), parameters=Parameters(samples=30))
        (warning,) = other.rank(first).warnings
        with pytest.raises(UnsuitedError, match=r"no class has two members.*; 1 of 3 shapes have the parameters"):
            other.evaluation(parameters=FEW)
    assert "no other shape has the parameters of the query, samples=40 seed=0" in warning
    assert "1 shape has samples=30 seed=2" in warning
