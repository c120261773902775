"""Search by PostgreSQL with pgvector: it agrees with the index in memory, and says when an answer is approximate."""

from __future__ import annotations

import itertools
import threading
from datetime import UTC, datetime

import numpy as np
import pytest
from sqlalchemy import create_engine, func, insert, select, text, update

from unbend import Parameters, Signature
from unbend.errors import ParameterError, StoreError, VectorsMissingError
from unbend.library import shape_rows
from unbend.library.packing import PackedSignature
from unbend.library.requests import ShapeRequest, Upload
from unbend.library.search import nearest
from unbend.library.search.index import IndexKey, SearchIndex
from unbend.library.search.nearest import Filter, choose_partition, find_nearest
from unbend.library.search.nearest_classes import SampledClasses, classify_nearest, draw_samples
from unbend.library.shape_rows import ComputedShape
from unbend.library.storage.schema import (
    descriptors,
    library_state,
    meshes,
    shapes,
    signatures,
)
from unbend.library.vector_rows import (
    VectorKind,
    add_vectors,
    build_indexes,
    create_vectors,
    drop_vectors,
    fill,
    find_partition,
    vectors,
)
from unbend.matching.classification import classify
from unbend.matching.measures.vectors import MOMENTS, SPECTRUM
from unbend.matching.selection import smallest
from unbend.signature.signature import ALGORITHM_VERSION

WIDTH = 12
PARAMETERS, OTHER = Parameters(samples=40), Parameters(samples=41)
KIND = VectorKind(SPECTRUM, PARAMETERS.to_json(), ALGORITHM_VERSION)
numbered = itertools.count()


@pytest.fixture
def empty(postgres, empty_postgres_library):
    """A library without vectors."""
    url = postgres.copy(empty_postgres_library)
    engine = create_engine(url)
    yield engine
    engine.dispose()
    postgres.drop(url)


@pytest.fixture
def engine(empty):
    """A library whose shapes have vectors."""
    with empty.begin() as connection:
        create_vectors(connection)
    assert fill(empty) == 0
    return empty


def add(connection, vector, label=None, described=None, parameters=PARAMETERS) -> str:
    """Add a shape, with its vectors if the library has any; return its id."""
    data = str(next(numbered)).encode()
    key = Upload(data, "off", parameters).key
    shape_rows.put_mesh(connection, key.sha256, data)
    descriptors = {"spectrum": np.asarray(vector, float), "moments": np.zeros(3)}
    points, faces = np.zeros((3, 3)), np.array([[0, 1, 2]])
    made = Signature(points, faces, np.arange(3), np.full(3, 1 / 3), 1.0, 0.0, 0.0, descriptors, parameters)
    packed = PackedSignature.of(made)
    record = shape_rows.add_shape(
        connection, ComputedShape(key, packed, area=1.0, report={}), ShapeRequest(data.decode(), label, described or {})
    )
    add_vectors(connection, record.seq, key.parameters, key.version, packed.vectors)
    return record.id


def add_many(engine, rows, labels=None, described=None) -> None:
    """Add shapes without vectors, as an earlier version would have stored them, to an empty library."""
    every = range(1, len(rows) + 1)
    key = Upload(b"", "off", PARAMETERS).key
    signature = {"parameters": key.parameters, "policy": key.policy, "version": key.version, "payload": b""}
    signature |= {"report": {}, "area": 1.0, "stress": 0.0}
    stored = {
        meshes: [{"sha256": f"{seq:064x}", "size": 0, "data": b""} for seq in every],
        signatures: [{"id": seq, "mesh_sha256": f"{seq:064x}", **signature} for seq in every],
        descriptors: [
            {"signature_id": seq, "measure": "spectrum", "vector": np.asarray(rows[seq - 1], "<f8").tobytes()}
            for seq in every
        ],
        shapes: [
            {
                "seq": seq, "id": f"{seq:032x}", "name": str(seq), "label": labels[seq - 1] if labels else None,
                "metadata": described[seq - 1] if described else {}, "signature_id": seq,
                "created_at": datetime(2026, 1, 1, tzinfo=UTC), "updated_at": datetime(2026, 1, 1, tzinfo=UTC),
            }
            for seq in every
        ],
    }  # fmt: skip
    with engine.begin() as connection:
        for into, values in stored.items():
            connection.execute(insert(into), values)
        for name in ("shapes_seq_seq", "signatures_id_seq"):
            connection.execute(select(func.setval(name, len(rows))))
        connection.execute(update(library_state).values(revision=len(rows)))


def poses(classes, members, spread=0.3, seed=0):
    """Return vectors (classes * members, WIDTH) in clusters, and their labels; clusters alternate."""
    random = np.random.default_rng(seed)
    centres = random.normal(size=(classes, WIDTH))
    codes = np.tile(np.arange(classes), members)
    return centres[codes] + spread * random.normal(size=(len(codes), WIDTH)), [f"class {code}" for code in codes]


def single(vector):
    return np.asarray(vector, np.float32)


def in_memory(connection, query, count, kept=None):
    """Return the seqs and distances of the index in memory; `kept` (seqs) are the only shapes compared."""
    snapshot = SearchIndex().snapshot(connection, IndexKey(SPECTRUM, KIND.parameters, KIND.version))
    distances = snapshot.distances(query, SPECTRUM)
    if kept is not None:
        distances[~np.isin(snapshot.seqs, list(kept))] = np.inf
    rows = smallest(distances, count)
    return snapshot.seqs[rows].tolist(), distances[rows].tolist()


def agree(found, expected):
    return found.seqs.tolist() == expected[0] and found.distances.tolist() == expected[1]


@pytest.fixture(scope="module")
def large(postgres, empty_postgres_library):
    """The address of a library of 3000 shapes with an index; a third are scans, and one in fifty is marked."""
    url = postgres.copy(empty_postgres_library)
    engine = create_engine(url)
    rows, labels = poses(classes=30, members=100)
    add_many(
        engine, rows, labels,
        [{"source": "scan" if row % 3 == 0 else "model", "marked": row % 50 == 0} for row in range(len(rows))],
    )  # fmt: skip
    with engine.begin() as connection:
        create_vectors(connection)
    assert fill(engine) == len(rows)
    assert build_indexes(engine) == 1  # of metadata: there are few vectors
    assert build_indexes(engine, least=len(rows)) == 1
    engine.dispose()
    return url


@pytest.fixture
def indexed(large):
    engine = create_engine(large)
    yield engine
    engine.dispose()


@pytest.fixture
def queries():
    return poses(classes=30, members=2, seed=0)[0].astype(np.float32)


def test_an_exact_answer_equals_that_of_the_index_in_memory_after_any_change(engine):
    rows, labels = poses(classes=4, members=10)
    with engine.begin() as connection:
        ids = [add(connection, row.round(1), label) for row, label in zip(rows, labels, strict=True)]
        twin = add(connection, rows[3].round(1), "twin")
        add(connection, rows[0], "elsewhere", parameters=OTHER)
    query = single(rows[3].round(1))
    for change in (
        shape_rows.count_shapes,
        lambda connection: shape_rows.change_shape(connection, ids[3], {"label": "new"}),
        lambda connection: shape_rows.remove_shape(connection, twin),
        lambda connection: add(connection, query + 0.01),
    ):
        with engine.begin() as connection:
            change(connection)
        with engine.connect() as connection:
            found = find_nearest(connection, find_partition(connection, KIND), query, 7)
            assert found.is_exact
            assert agree(found, in_memory(connection, query, 7))
            named = dict(connection.execute(select(shapes.c.seq, shapes.c.label)).all())
            assert list(found.labels) == [named[seq] for seq in found.seqs]


def test_vectors_are_added_and_removed_in_the_transaction_of_their_shape(engine):
    with engine.connect() as connection:
        add(connection, np.zeros(WIDTH))
        connection.rollback()
        assert connection.scalar(select(func.count()).select_from(vectors)) == 0
        shape_id = add(connection, np.zeros(WIDTH))
        connection.commit()
        shape_rows.remove_shape(connection, shape_id)
        connection.rollback()
        assert connection.scalar(select(func.count()).select_from(vectors)) == 1
        shape_rows.remove_shape(connection, shape_id)
        connection.commit()
        assert connection.scalar(select(func.count()).select_from(vectors)) == 0


def test_an_index_finds_nearly_all_and_says_that_it_is_approximate(indexed, queries):
    hits = []
    with indexed.connect() as connection:
        partition = find_partition(connection, KIND)
        for query in queries:
            found = find_nearest(connection, partition, query, 10)
            assert not found.is_exact
            seqs, distances = in_memory(connection, query, 10)
            hits.append(len(set(seqs) & set(found.seqs.tolist())) / 10)
            exact = dict(zip(seqs, distances, strict=True))
            ours = dict(zip(found.seqs.tolist(), found.distances.tolist(), strict=True))
            assert all(ours[seq] == exact[seq] for seq in ours.keys() & exact.keys())
            assert agree(find_nearest(connection, partition, query, 10, exact=True), (seqs, distances))
    assert np.mean(hits) >= 0.98


def test_more_shapes_than_an_index_yields_are_found_exactly(indexed, queries):
    with indexed.connect() as connection:
        found = find_nearest(connection, find_partition(connection, KIND), queries[0], 2000)
        assert found.is_exact
        assert agree(found, in_memory(connection, queries[0], 2000))


@pytest.mark.parametrize("few", [0, 1000])
@pytest.mark.parametrize(
    "only",
    [
        Filter(label="class 3"),
        Filter(metadata={"source": "scan"}),
        Filter(metadata={"marked": True}),
        Filter("class 5", {"source": "model", "marked": False}),
        Filter(is_labelled=True),
    ],
    ids=str,
)
def test_a_filter_keeps_only_its_shapes_with_and_without_the_index(indexed, queries, monkeypatch, only, few):
    monkeypatch.setattr(nearest, "_FEW", few)
    kept_rows = select(shapes.c.seq, shapes.c.label, shapes.c.metadata)
    hits = []
    with indexed.connect() as connection:
        kept = {
            row.seq
            for row in connection.execute(kept_rows)
            if (only.label is None or row.label == only.label) and only.metadata.items() <= row.metadata.items()
        }
        for query in queries[:10]:
            found = find_nearest(connection, find_partition(connection, KIND), query, 10, only)
            assert found.is_exact == (few > 0)
            assert set(found.seqs.tolist()) <= kept
            hits.append(len(set(found.seqs.tolist()) & set(in_memory(connection, query, 10, kept)[0])) / 10)
    assert np.mean(hits) >= (1 if few else 0.97)


def test_an_index_that_does_not_find_enough_is_not_believed(indexed, queries, monkeypatch):
    monkeypatch.setattr(nearest, "_FEW", 0)
    only = Filter("class 0", {"marked": True})
    with indexed.connect() as connection:
        kept = select(shapes.c.seq).where(shapes.c.label == "class 0", (shapes.c.seq - 1) % 50 == 0)
        expected = in_memory(connection, queries[0], 10, connection.scalars(kept).all())
        assert len(expected[0]) == 10
        found = find_nearest(connection, find_partition(connection, KIND), queries[0], 10, only)
        assert found.is_exact
        assert agree(found, expected)


def test_a_stored_query_is_left_out(engine):
    rows, labels = poses(classes=2, members=5)
    add_many(engine, rows, labels)
    fill(engine)
    with engine.connect() as connection:
        partition = find_partition(connection, KIND)
        own = find_nearest(connection, partition, single(rows[4]), 1)
        assert own.distances[0] == 0
        others = find_nearest(connection, partition, single(rows[4]), 20, without=int(own.seqs[0]))
        assert len(others.seqs) == 9
        assert own.seqs[0] not in others.seqs


def test_earlier_shapes_are_searched_once_all_have_vectors(empty):
    rows, labels = poses(classes=3, members=5)
    add_many(empty, rows, labels)
    with empty.begin() as connection:
        assert find_partition(connection, KIND) is None  # no tables
        create_vectors(connection)
    with empty.begin() as connection:
        add(connection, rows[0], "later")
        assert find_partition(connection, KIND) is None  # the earlier shapes are missing
    assert fill(empty) == len(rows)
    assert fill(empty) == 0
    with empty.begin() as connection:
        found = find_nearest(connection, find_partition(connection, KIND), single(rows[0]), 30)
        assert agree(found, in_memory(connection, single(rows[0]), 30))
        drop_vectors(connection)
        assert find_partition(connection, KIND) is None
        shape_rows.remove_shape(connection, add(connection, rows[0]))


def test_shapes_that_are_removed_while_others_are_filled_in_stop_nothing(empty):
    rows, _ = poses(classes=100, members=25)
    add_many(empty, rows)
    with empty.begin() as connection:
        create_vectors(connection)

    def remove():
        for seq in range(len(rows), len(rows) - 100, -1):
            with empty.begin() as connection:
                shape_rows.remove_shape(connection, f"{seq:032x}")

    remover = threading.Thread(target=remove)
    remover.start()
    fill(empty)
    remover.join()
    with empty.connect() as connection:
        assert connection.scalar(select(func.count()).select_from(vectors)) == len(rows) - 100


def test_several_processes_may_create_the_tables_at_a_time(empty):
    failures = []

    def create():
        try:
            with empty.begin() as connection:
                create_vectors(connection)
        except Exception as error:  # noqa: BLE001
            failures.append(error)

    threads = [threading.Thread(target=create) for _ in range(5)]
    for each in threads:
        each.start()
    for each in threads:
        each.join()
    assert failures == []


def test_a_role_that_may_not_create_the_extension_learns_what_to_do(postgres, empty):
    postgres.execute("CREATE ROLE plain LOGIN")
    plain = create_engine(empty.url.set(username="plain"))
    with plain.begin() as connection:
        with pytest.raises(VectorsMissingError, match="cannot create it") as caught:
            create_vectors(connection)
        assert "UNBEND_SEARCH=memory" in caught.value.advice
        assert find_partition(connection, KIND) is None  # the transaction goes on
    plain.dispose()


def test_sqlite_has_no_vectors():
    with create_engine("sqlite://").connect() as connection:
        assert find_partition(connection, KIND) is None


def test_an_index_that_an_interrupted_build_left_is_built_again(postgres, large, queries):
    url = postgres.copy(large)
    engine = create_engine(url)
    with engine.begin() as connection:
        invalid = "UPDATE pg_index SET indisvalid = false WHERE indexrelid = 'ix_vectors_embedding_1'::regclass"
        connection.execute(text(invalid))
        assert find_nearest(connection, find_partition(connection, KIND), queries[0], 10).is_exact
    assert build_indexes(engine, least=3000) == 1
    assert build_indexes(engine, least=3000) == 0
    with engine.connect() as connection:
        assert not find_nearest(connection, find_partition(connection, KIND), queries[0], 10).is_exact
    engine.dispose()
    postgres.drop(url)


def test_metadata_that_no_index_represents_can_be_stored(engine):
    assert build_indexes(engine) == 1
    with engine.begin() as connection:
        add(connection, np.zeros(WIDTH), described={"odd": "a\0b"})
        add(connection, np.ones(WIDTH), described={"odd": "ab"})
        found = find_nearest(
            connection, find_partition(connection, KIND), single(np.zeros(WIDTH)), 5, Filter(metadata={"odd": "ab"})
        )
        assert found.distances.tolist() == [WIDTH]


def test_vectors_of_another_length_are_refused(engine):
    with engine.begin() as connection:
        add(connection, np.zeros(WIDTH))
        with pytest.raises(ParameterError, match="3"):
            find_nearest(connection, find_partition(connection, KIND), single(np.zeros(3)), 5)
        with pytest.raises(ParameterError, match="not finite"):
            find_nearest(connection, find_partition(connection, KIND), single(np.full(WIDTH, np.nan)), 5)
        with pytest.raises(StoreError, match="3 numbers where others have 12"):
            add(connection, np.zeros(3))


def test_vectors_at_infinite_distance_are_never_found(engine):
    with engine.begin() as connection:
        add(connection, np.full(WIDTH, np.inf))
        add(connection, np.zeros(WIDTH))
        found = find_nearest(connection, find_partition(connection, KIND), single(np.zeros(WIDTH)), 5)
        assert found.distances.tolist() == [0]


@pytest.mark.parametrize("classifier", ["nearest", "vote"])
def test_classes_agree_with_those_of_the_index_in_memory(indexed, classifier):
    queries = np.concatenate([poses(30, 2)[0], np.random.default_rng(9).normal(size=(20, WIDTH))]).astype(np.float32)
    agreed = []
    with indexed.connect() as connection:
        partition = find_partition(connection, KIND)
        samples = draw_samples(connection, partition)
        assert samples.labels == tuple(sorted(f"class {code}" for code in range(30)))
        assert samples.sizes.tolist() == [100] * 30
        snapshot = SearchIndex().snapshot(connection, IndexKey(SPECTRUM, KIND.parameters, KIND.version))
        for query in queries:
            ours = classify_nearest(connection, partition, query, samples, classifier)
            full = classify(snapshot.gallery, SPECTRUM, query, snapshot.distances(query, SPECTRUM), classifier)
            assert ours.matches[0].label == full.matches[0].label
            assert ours.matches[0].distance == full.matches[0].distance
            assert ours.known == full.known
            agreed.append(abs(ours.matches[0].confidence - full.matches[0].confidence) < 0.01)
    assert np.mean(agreed) >= 0.95


def test_classes_of_a_small_library_are_exactly_those_of_the_index_in_memory(engine):
    rows, labels = poses(classes=5, members=8)
    add_many(engine, rows, [label if row % 3 else None for row, label in enumerate(labels)])
    fill(engine)
    with engine.connect() as connection:
        partition = find_partition(connection, KIND)
        snapshot = SearchIndex().snapshot(connection, IndexKey(SPECTRUM, KIND.parameters, KIND.version))
        for query in rows[:10].astype(np.float32):
            own = find_nearest(connection, partition, query, 1).seqs[0]
            rest = snapshot.without(snapshot.row(own))
            ours = classify_nearest(
                connection, partition, query, draw_samples(connection, partition), "vote", without=int(own)
            )
            assert ours == classify(rest.gallery, SPECTRUM, query, rest.distances(query, SPECTRUM), "vote")


def test_classes_are_exact_on_request(indexed, queries):
    with indexed.connect() as connection:
        partition = find_partition(connection, KIND)
        samples = draw_samples(connection, partition)
        snapshot = SearchIndex().snapshot(connection, IndexKey(SPECTRUM, KIND.parameters, KIND.version))
        for query in queries[:5]:
            ours = classify_nearest(connection, partition, query, samples, "nearest", exact=True)
            full = classify(snapshot.gallery, SPECTRUM, query, snapshot.distances(query, SPECTRUM))
            assert ours.known == full.known
            for match, expected in zip(ours.matches, full.matches, strict=False):
                assert (match.label, match.distance) == (expected.label, expected.distance)
                assert match.confidence == pytest.approx(expected.confidence, rel=1e-4)


def test_a_library_without_classes_has_no_best_class(engine):
    with engine.begin() as connection:
        add(connection, np.zeros(WIDTH))
        partition = find_partition(connection, KIND)
        found = classify_nearest(
            connection, partition, single(np.zeros(WIDTH)), draw_samples(connection, partition), "nearest"
        )
    assert (found.matches, found.known) == ([], None)


def test_a_classifier_of_all_shapes_is_refused(engine):
    with engine.begin() as connection:
        add(connection, np.zeros(WIDTH), "a")
        partition = find_partition(connection, KIND)
        with pytest.raises(ParameterError, match="mean needs the vectors of all shapes"):
            classify_nearest(
                connection, partition, single(np.zeros(WIDTH)), draw_samples(connection, partition), "mean"
            )


def test_samples_are_drawn_again_after_many_changes_or_a_restore(engine):
    rows, labels = poses(classes=4, members=10)
    add_many(engine, rows, labels)
    fill(engine)
    drawn = SampledClasses()
    with engine.begin() as connection:
        partition = find_partition(connection, KIND)
        first = drawn.of(connection, partition)
        add(connection, rows[0], "class 0")
        assert drawn.of(connection, partition) is first
        for row in rows[:3]:
            add(connection, row, "new")
        second = drawn.of(connection, partition)
        assert second.labels == (*first.labels, "new")
        connection.execute(update(library_state).values(epoch="second"))
        assert drawn.of(connection, partition) is not second


def test_other_measures_are_not_searched_by_the_database(engine):
    with engine.begin() as connection:
        add(connection, np.zeros(WIDTH))
        assert find_partition(connection, VectorKind(MOMENTS, KIND.parameters, KIND.version)) is None


def test_the_database_searches_if_it_can_and_by_default_only_if_it_is_large(empty, indexed, monkeypatch):
    other = VectorKind(MOMENTS, KIND.parameters, KIND.version)
    with indexed.connect() as connection:
        assert choose_partition(connection, KIND, "memory") is None
        assert choose_partition(connection, KIND, "database") == find_partition(connection, KIND)
        assert choose_partition(connection, other, "database") is None
        assert choose_partition(connection, KIND, "auto") is None
        monkeypatch.setattr(nearest, "AUTO_ROWS", 3000)
        assert choose_partition(connection, KIND, "auto") == find_partition(connection, KIND)
    with empty.connect() as connection:
        assert choose_partition(connection, KIND, "auto") is None
        with pytest.raises(VectorsMissingError, match="no vectors"):
            choose_partition(connection, KIND, "database")
