"""The search index: it agrees with the store at every query, whoever changed the store."""

from __future__ import annotations

import itertools
import sqlite3
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sqlalchemy import event

from unbend import Library, Parameters, Signature
from unbend.errors import NotFoundError, StoreError
from unbend.library import shape_rows
from unbend.library.packing import PackedSignature
from unbend.library.requests import ShapeRequest, Upload
from unbend.library.search.index import IndexKey, SearchIndex
from unbend.library.shape_rows import ComputedShape
from unbend.matching.gallery import UNLABELLED
from unbend.matching.measures import VectorMeasure, get_vector_measure
from unbend.signature.signature import ALGORITHM_VERSION

ONE, OTHER = Parameters(samples=40), Parameters(samples=41)
MOMENTS = get_vector_measure("moments")
KEY = IndexKey(MOMENTS, ONE.to_json(), ALGORITHM_VERSION)
WIDTH = 3
numbered = itertools.count()


def signature(vector, parameters=ONE, **others) -> Signature:
    """Return a signature in which only the descriptors matter."""
    points, faces = np.zeros((3, 3)), np.array([[0, 1, 2]])
    descriptors = {"moments": np.asarray(vector, float), **others}
    return Signature(points, faces, np.arange(3), np.full(3, 1 / 3), 1.0, 0.0, 0.0, descriptors, parameters)


def add(library: Library, vector, label=None, parameters=ONE, **others) -> str:
    """Store a shape with `vector` as its moments and its name; return its id."""
    with library.store.write() as connection:
        return insert(connection, vector, label, parameters, **others)


def insert(connection, vector, label=None, parameters=ONE, **others) -> str:
    data = str(next(numbered)).encode()
    key = Upload(data, "off", parameters).key
    shape_rows.put_mesh(connection, key.sha256, data)
    computed = ComputedShape(key, PackedSignature.of(signature(vector, parameters, **others)), area=1.0, report={})
    return shape_rows.add_shape(connection, computed, ShapeRequest(str(list(vector)), label)).id


def snapshot_of(library: Library, index: SearchIndex, key: IndexKey = KEY):
    with library.store.read() as connection:
        return index.snapshot(connection, key)


def expected(path, query, parameters=ONE, *, but=""):
    """Compute the answer of a search with plain SQL and NumPy: shapes, nearest first, and distances of classes."""
    connection = sqlite3.connect(path)
    stored = connection.execute(
        "SELECT shapes.id, name, label, vector FROM shapes JOIN signatures ON signatures.id = shapes.signature_id"
        " JOIN descriptors ON descriptors.signature_id = signatures.id"
        " WHERE measure = 'moments' AND parameters = ? AND shapes.id != ? ORDER BY seq",
        (parameters.to_json(), but),
    ).fetchall()
    connection.close()
    shapes, classes = [], {}
    for shape_id, name, label, vector in stored:
        distance = float(np.abs(np.frombuffer(vector) - query).sum())
        shapes.append((shape_id, name, label, distance))
        if label is not None:
            classes[label] = min(distance, classes.get(label, np.inf))
    return sorted(shapes, key=lambda shape: shape[3]), classes


def check(library: Library, path, query=(0.0, 0.0, 0.0), parameters=ONE) -> None:
    """Compare the library's answers to a signature and to its first shape with the expected answers."""
    answers = [(library.rank(signature(query, parameters), measure="moments", k=1000), query, "")]
    first = library.page(limit=1).items
    if first and first[0].parameters == parameters:
        vector = library.signature(first[0].id).descriptors["moments"]
        answers.append((library.rank(first[0].id, measure="moments", k=1000), vector, first[0].id))
    for ranking, vector, but in answers:
        shapes, classes = expected(path, np.array(vector), parameters, but=but)
        assert [(match.id, match.name, match.label, match.distance) for match in ranking.shapes] == shapes
        assert {match.label: match.distance for match in ranking.classes} == classes


# Integers, so that sums are exact and ties are common.
vectors = st.lists(st.integers(0, 2), min_size=WIDTH, max_size=WIDTH)
labels = st.sampled_from([None, "a", "b", "c"])
places = st.integers(0, 100)
changes = st.one_of(
    st.tuples(st.just("add"), vectors, labels),
    st.tuples(st.just("add elsewhere"), vectors, labels),
    st.tuples(st.just("label"), places, labels),
    st.tuples(st.just("name"), places, st.sampled_from(["x", "y"])),
    st.tuples(st.just("remove"), places, st.none()),
)


@settings(max_examples=15)
@given(st.lists(st.tuples(changes, st.booleans(), st.booleans()), max_size=20))
def test_two_libraries_on_one_file_agree_with_the_store_after_any_changes(tmp_path_factory, steps):
    path = tmp_path_factory.mktemp("index") / "library.db"
    with Library(str(path)) as one, Library(str(path)) as two:
        ids = []
        for (kind, what, value), by_one, asked in steps:
            writer = one if by_one else two
            if kind == "add":
                ids.append(add(writer, what, value))
            elif kind == "add elsewhere":
                ids.append(add(writer, what, value, OTHER))
            elif ids and kind == "remove":
                writer.remove(ids.pop(what % len(ids)))
            elif ids:
                writer.change(ids[what % len(ids)], **{kind: value})
            if asked:  # after one change or after several
                check(one, path)
        for library in (one, two):
            check(library, path)
            check(library, path, parameters=OTHER)


def test_changes_by_another_process_are_seen(library, path):
    ids = [add(library, (number, 0, 0), "old") for number in range(4)]
    check(library, path)
    changes = f"""
from unbend import Library
with Library({str(path)!r}) as library:
    library.change({ids[0]!r}, label="new", name="renamed")
    library.remove({ids[2]!r})
"""
    subprocess.run([sys.executable, "-c", changes], check=True)
    check(library, path)
    ranking = library.rank(signature((0, 0, 0)), measure="moments")
    assert [(match.name, match.label) for match in ranking.shapes][:1] == [("renamed", "new")]
    assert [match.id for match in ranking.shapes] == [ids[0], ids[1], ids[3]]


def test_a_snapshot_does_not_change(library):
    ids = [add(library, (number, 0, 0), "a") for number in range(10)]
    index = SearchIndex()
    first = snapshot_of(library, index)
    before = first.gallery.vectors.copy(), first.gallery.codes.copy(), first.seqs.copy()
    library.change(ids[3], label="b")
    library.remove(ids[4])
    add(library, (99, 0, 0), "c")
    second = snapshot_of(library, index)
    assert (len(first), len(second)) == (10, 10)
    assert [second.gallery.label(row) for row in (3, 4, 10)] == ["b", None, "c"]
    for old, array in zip(before, (first.gallery.vectors, first.gallery.codes, first.seqs), strict=True):
        assert np.array_equal(old, array)
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
    assert (first.gallery.labels, len(first.excluded)) == (("a",), 0)


def test_additions_and_changes_neither_read_nor_move_existing_rows(library):
    ids = [add(library, (number, 0, 0), "a") for number in range(5)]
    index = SearchIndex()
    snapshot_of(library, index)
    add(library, (5, 0, 0))
    grown = snapshot_of(library, index)  # the table has grown, with free rows
    read = []
    event.listen(library.store._engine, "before_cursor_execute", lambda *call: read.append((call[2], call[3])))
    seen = grown
    for change in (
        lambda: add(library, (6, 0, 0), "b"),
        lambda: library.change(ids[0], label="b"),
        lambda: library.remove(ids[1]),
    ):
        change()
        read.clear()
        now = snapshot_of(library, index)
        assert np.shares_memory(now.gallery.vectors, grown.gallery.vectors)
        (after,) = (values for text, values in read if "descriptors" in text)
        assert seen.seqs[-1] in (after.values() if isinstance(after, dict) else after)
        seen = now
    read.clear()
    assert snapshot_of(library, index) is seen
    assert not any("descriptors" in text for text, _ in read)


def test_removed_rows_are_dropped_once_they_are_a_quarter_of_the_table(library, path):
    ids = [add(library, (number, 0, 0), "a" if number % 2 else None) for number in range(16)]
    index = SearchIndex()
    snapshot_of(library, index)
    for shape_id in ids[3:7]:
        library.remove(shape_id)
    kept = snapshot_of(library, index)
    assert (len(kept), len(kept.seqs), len(kept.excluded)) == (12, 16, 4)
    assert (kept.gallery.codes[3:7] == UNLABELLED).all()
    assert np.isinf(kept.distances(np.zeros(WIDTH, np.float32), MOMENTS)).nonzero()[0].tolist() == [3, 4, 5, 6]
    library.remove(ids[0])
    add(library, (50, 0, 0), "b")
    dropped = snapshot_of(library, index)
    assert (len(dropped), len(dropped.seqs), len(dropped.excluded)) == (12, 12, 0)
    assert dropped.gallery.vectors[:, 0].tolist() == [1, 2, *range(7, 16), 50]
    assert [dropped.gallery.label(row) for row in range(12)] == ["a", None, *["a", None] * 4, "a", "b"]
    check(library, path)


def test_all_shapes_can_be_removed_and_others_added(library, path):
    ids = [add(library, (number, 0, 0), "a") for number in range(3)]
    check(library, path)
    for shape_id in ids:
        library.remove(shape_id)
        check(library, path)
    add(library, (1, 2, 3), "b")
    check(library, path)


def test_a_shape_added_and_removed_between_two_queries_is_not_found(library, path):
    add(library, (1, 0, 0))
    check(library, path)
    library.remove(add(library, (2, 0, 0), "a"))
    check(library, path)


def test_more_results_than_one_sql_statement_fetches_are_sorted(library, path):
    with library.store.write() as connection:
        for number in range(shape_rows.MAX_PAGE + 20):
            insert(connection, (number % 7, number % 5, 0), f"class {number % 11}")
    check(library, path)


def test_a_vector_is_the_weighted_concatenation_of_its_descriptors(library):
    weighted = VectorMeasure("both", parts=(("surface_moments", 0.3), ("moments", 1 / 7)))
    random = np.random.default_rng(0)
    wanted = []
    with library.store.write() as connection:
        for _ in range(600):  # so many that they are read in several chunks
            ours = random.normal(size=WIDTH), random.normal(size=5)
            insert(connection, ours[0], surface_moments=ours[1])
            wanted.append(weighted.vector({"moments": ours[0], "surface_moments": ours[1]}))
    add(library, (1, 2, 3))  # lacks the other descriptor, so it cannot be compared
    found = snapshot_of(library, SearchIndex(), IndexKey(weighted, KEY.parameters, KEY.version))
    assert np.array_equal(found.gallery.vectors, np.stack(wanted))


def test_a_query_by_a_shape_without_the_descriptor_names_the_shape(library):
    shape_id = add(library, (1, 2, 3))
    with pytest.raises(NotFoundError, match=f"{shape_id}.*spectrum"):
        library.rank(shape_id, measure="spectrum")


@pytest.mark.parametrize("before", [0, 1, 300])
def test_a_descriptor_of_another_length_is_a_store_error_until_it_is_removed(library, path, before):
    with library.store.write() as connection:
        for number in range(before):
            insert(connection, (number, 0, 0))
    loaded, fresh = SearchIndex(), SearchIndex()
    good = snapshot_of(library, loaded)
    longer = add(library, (1, 2, 3, 4))
    add(library, (7, 7, 7), "late")
    for index in (loaded, fresh):
        with pytest.raises(StoreError, match="stored descriptor"):
            snapshot_of(library, index)
    library.remove(longer)
    for index in (loaded, fresh):
        again = snapshot_of(library, index)
        assert again.gallery.vectors[:, 0].tolist() == [*range(before), 7]
        assert (len(again), again.gallery.labels) == (before + 1, ("late",))
    assert len(good) == before
    check(library, path)


def test_a_store_reset_to_an_earlier_state_is_read_again(library, path, tmp_path):
    add(library, (1, 0, 0), "a")
    check(library, path)
    copy, live = sqlite3.connect(tmp_path / "copy.db"), sqlite3.connect(path)
    live.backup(copy)
    library.change(add(library, (2, 0, 0), "b"), label="c")
    check(library, path)
    copy.backup(live)
    copy.close()
    live.close()
    check(library, path)
    assert len(library) == 1


def test_simultaneous_queries_load_a_table_once(library):
    with library.store.write() as connection:
        for number in range(50):
            insert(connection, (number, 0, 0))
    index, start = SearchIndex(), threading.Barrier(6)
    reads = []
    event.listen(library.store._engine, "before_cursor_execute", lambda *call: reads.append(call[2]))

    def ask(_):
        start.wait()
        return snapshot_of(library, index)

    with ThreadPoolExecutor(6) as pool:
        found = list(pool.map(ask, range(6)))
    assert all(one is found[0] for one in found)
    assert sum("descriptors" in statement for statement in reads) == 1


def test_answers_are_consistent_while_threads_change_the_library(path):
    """A shape's name is its vector, and its label depends on the vector, so every answer can be checked by itself."""
    query = signature((0, 0, 0))
    with Library(str(path)) as one, Library(str(path)) as two:
        for number in range(20):
            add(one, (number, number % 3, 0), "even" if number % 2 == 0 else "odd")
        stop = threading.Event()

        def change(library: Library) -> None:
            random = np.random.default_rng(id(library) % 1000)
            for _ in range(25):
                number = int(random.integers(1000))
                shape_id = add(library, (number, 1, 0), "even" if number % 2 == 0 else "odd")
                library.change(shape_id, label="moved")
                library.change(shape_id, label="even" if number % 2 == 0 else "odd")
                if number % 3:
                    library.remove(shape_id)
            stop.set()

        def ask(library: Library) -> int:
            asked = 0
            while not stop.is_set() or not asked:
                ranking = library.rank(query, measure="moments", k=1000)
                nearest: dict[str, float] = {}
                for match in ranking.shapes:
                    vector = np.array(match.name[1:-1].split(", "), float)
                    assert match.distance == vector.sum()
                    assert match.label in {"moved", "even" if vector[0] % 2 == 0 else "odd"}
                    nearest.setdefault(match.label, match.distance)
                assert {match.label: match.distance for match in ranking.classes} == nearest
                assert len(ranking.shapes) >= 20
                asked += 1
            return asked

        with ThreadPoolExecutor(6) as pool:
            writers = [pool.submit(change, library) for library in (one, two)]
            readers = [pool.submit(ask, library) for library in (one, two, one, two)]
            for thread in (*writers, *readers):
                thread.result()
        for library in (one, two):
            check(library, path)


def test_empty_tables_are_not_cached_and_others_only_up_to_a_limit(library):
    add(library, (1.0, 2.0, 3.0))
    index = SearchIndex()
    with library.store.read() as connection:
        for samples in range(100, 400):  # clients may ask for any parameters
            key = IndexKey(MOMENTS, Parameters(samples=samples).to_json(), ALGORITHM_VERSION)
            assert len(index.snapshot(connection, key).seqs) == 0
        assert len(index) == 0
        assert len(index.snapshot(connection, KEY).seqs) == 1
        assert len(index) == 1
    for samples in range(100, 140):
        add(library, (1.0, 2.0, 3.0), parameters=Parameters(samples=samples))
    with library.store.read() as connection:
        for samples in range(100, 140):
            index.snapshot(connection, IndexKey(MOMENTS, Parameters(samples=samples).to_json(), ALGORITHM_VERSION))
        assert len(index) == 32
        assert len(index.snapshot(connection, KEY).seqs) == 1
