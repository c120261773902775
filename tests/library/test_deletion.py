"""Deletion: removed content does not remain in the database file, its write-ahead log, or stored jobs."""

from __future__ import annotations

import sqlite3
import time
from contextlib import closing

import numpy as np
import pytest

from tests.support.server import DAMAGED, ended, post_mesh, small_mesh
from tests.support.store import PARAMETERS, add, in_files, insert
from unbend import Library
from unbend.errors import NotFoundError
from unbend.library import job_rows, shape_rows
from unbend.library.requests import QueryRequest, ShapeRequest, Upload

SECRETS = (b"MARKER-OF-THE-MESH", b"name-of-it", b"label-of-it", b"metadata-of-it")
LONG = SECRETS[0] * 2000
"""A mesh file that takes many pages of the database."""


def on_disk(path, text: bytes) -> bool:
    """Tell whether the database's files contain `text`; an assert on the bytes would print megabytes on a failure."""
    return text in in_files(path)


def assert_no_secrets(path, *others: bytes) -> None:
    assert in_files(path)[:6] == b"SQLite"
    assert [secret for secret in (*SECRETS, *others) if on_disk(path, secret)] == []


def assert_soon_gone(path, text: bytes) -> None:
    """Wait until `text` is gone: the write-ahead log is truncated a second after a job ends."""
    until = time.monotonic() + 10.0
    while on_disk(path, text) and time.monotonic() < until:
        time.sleep(0.1)
    assert not on_disk(path, text)


def add_secret(library: Library, data: bytes = LONG) -> str:
    return add(library, data, "name-of-it", "label-of-it", {"key": "metadata-of-it"}).id


def start_job(library: Library, data: bytes, request: ShapeRequest | QueryRequest) -> str:
    """Start a job; return its id."""
    key = Upload(data, "off", PARAMETERS).key
    with library.store.write() as connection:
        shape_rows.put_mesh(connection, key.sha256, data)
        job = job_rows.enqueue(connection, job_id=job_rows.new_id(), key=key, file_type="off", request=request)
        assert job_rows.claim(connection).id == job.id
    return job.id


def end(library: Library, job_id: str, state: str, **values) -> job_rows.JobRecord:
    with library.store.write() as connection:
        assert job_rows.finish(connection, job_id, state, **values)
    return job_of(library, job_id)


def job_of(library: Library, job_id: str) -> job_rows.JobRecord:
    with library.store.read() as connection:
        return job_rows.get_job(connection, job_id)


@pytest.mark.parametrize("data", [LONG, SECRETS[0]], ids=["many pages", "a few bytes"])
def test_a_removed_shape_leaves_no_byte_on_disk(library, path, data):
    add(library, b"another file", "other", "others")
    shape_id = add_secret(library, data)
    assert all(secret in in_files(path) for secret in SECRETS)
    library.remove(shape_id)
    assert_no_secrets(path)
    assert [shape.name for shape in library.page().items] == ["other"]


def test_many_removed_shapes_leave_no_byte_on_disk_among_other_changes(library, path):
    random = np.random.default_rng(0)
    there: dict[bytes, str] = {}
    gone = []
    for number in range(90):
        mark = b"MARK%06d;" % (number * 7919)
        data = mark * int(random.integers(1, 1500 if number % 10 == 0 else 40))
        there[mark] = add(
            library, data, mark.decode() * 3, mark.decode() if number % 3 else None, {"a": mark.decode()}
        ).id
        while len(there) > 1 and random.random() < 0.45:
            mark = list(there)[int(random.integers(len(there)))]
            if random.random() < 0.5:
                library.change(there[mark], name=mark.decode() * int(random.integers(1, 19)), label="x")
            else:
                library.remove(there.pop(mark))
                gone.append(mark)
    found = in_files(path)
    assert len(gone) > 25
    assert [mark for mark in gone if mark in found] == []
    assert all(mark in found for mark in there)


def test_a_removed_shape_leaves_no_byte_after_a_concurrent_reader_ends(library, path):
    shape_id = add_secret(library)
    with library.store.read() as connection:
        assert shape_rows.count_shapes(connection) == 1
        began = time.monotonic()
        library.remove(shape_id)
        assert time.monotonic() - began < 5.0  # the removal does not wait for the reader
        assert shape_rows.get_shape(connection, shape_id).name == "name-of-it"
    end = time.monotonic() + 20.0
    while any(secret in in_files(path) for secret in SECRETS) and time.monotonic() < end:
        time.sleep(0.1)
    assert_no_secrets(path)


def test_a_mesh_file_stays_while_a_job_needs_it(library, path):
    shape_id = add_secret(library)
    failed = start_job(library, LONG, ShapeRequest("name-of-it", "label-of-it"))
    library.remove(shape_id)
    assert on_disk(path, LONG[:40])  # the job needs the file
    end(library, failed, "cancelled")
    assert_soon_gone(path, LONG[:40])


def test_the_job_of_a_removed_shape_keeps_no_details(library, path):
    job_id = start_job(library, LONG, ShapeRequest("name-of-it", "label-of-it", {"k": "metadata-of-it"}))
    with library.store.write() as connection:
        shape = insert(connection, LONG, "name-of-it", "label-of-it", {"k": "metadata-of-it"})
        job_rows.finish(connection, job_id, "succeeded", shape_id=shape.id)
    library.change(shape.id, name="renamed")  # the name in the request now differs from the shape's name
    library.remove(shape.id)
    job = job_of(library, job_id)
    assert (job.state, job.shape_id, job.request, job.mesh_sha256) == ("succeeded", shape.id, None, None)
    assert_no_secrets(path, b"renamed", shape.sha256.encode())


def ranking(*shapes, classes=()) -> dict:
    return {
        "measure": "moments",
        "classes": [{"label": label, "distance": 0.5, "confidence": 0.5} for label in classes],
        "shapes": [
            {"id": one.id, "name": one.name, "label": one.label, "distance": 0.1, "part": None} for one in shapes
        ],
        "known": True,
    }


def test_stored_results_do_not_name_a_removed_shape(library, path):
    kept = add(library, b"kept", "kept", "a")
    secret = library.get(add_secret(library))
    other = add(library, b"more", "more", "label-of-it")
    first = start_job(library, b"one", QueryRequest("moments", k=9))
    end(library, first, "succeeded", result=ranking(secret, kept, other, classes=["label-of-it", "a"]))
    unconcerned = start_job(library, b"two", QueryRequest("moments", k=1))
    end(library, unconcerned, "succeeded", result=ranking(kept, classes=["a", "label-of-it"]))
    library.remove(secret.id)
    assert job_of(library, first).result == ranking(kept, other, classes=["label-of-it", "a"])
    assert not on_disk(path, b"name-of-it")
    library.remove(other.id)  # the last member of its class
    assert job_of(library, first).result == ranking(kept, classes=["a"])
    assert job_of(library, unconcerned).result == ranking(kept, classes=["a"])
    assert_no_secrets(path)


def test_an_unused_label_leaves_no_byte_on_disk(library, path):
    shape_id = add_secret(library)
    job_id = start_job(library, b"q", QueryRequest("moments", k=9))
    answer = ranking(library.get(shape_id), classes=["label-of-it"])
    end(library, job_id, "succeeded", result=answer)
    library.change(shape_id, label="another", name="renamed", metadata={})
    assert_soon_gone(path, b"label-of-it")
    reported = job_of(library, job_id).result
    assert reported["classes"] == []
    assert [(match["name"], match["label"]) for match in reported["shapes"]] == [("renamed", "another")]
    library.remove(shape_id)
    assert job_of(library, job_id).result == ranking()
    assert_no_secrets(path, b"renamed", b"another")


def test_a_reused_label_is_a_new_class(library):
    first = add(library, b"one", "one", "a")
    job_id = start_job(library, b"q", QueryRequest("moments", k=9))
    end(library, job_id, "succeeded", result=ranking(classes=["a"]))
    library.remove(first.id)
    add(library, b"two", "two", "a")
    assert job_of(library, job_id).result == ranking()


def test_the_request_of_an_upload_is_deleted_when_its_job_ends(library, path):
    said = ShapeRequest("name-of-it", "label-of-it", {"k": "metadata-of-it"})
    for state in ("failed", "cancelled"):
        job_id = start_job(library, LONG, said)
        assert end(library, job_id, state).request is None
    for secret in SECRETS:
        assert_soon_gone(path, secret)


def test_a_label_with_special_characters_is_removed_from_results(library, path):
    label = 'caf\u00e9 "100%_\\ \u2028'
    secret = add(library, b"x", "x", label)
    job_id = start_job(library, b"q", QueryRequest("moments", k=9))
    end(library, job_id, "succeeded", result=ranking(classes=[label]))
    library.remove(secret.id)
    assert job_of(library, job_id).result == ranking()


def test_a_result_finished_after_a_removal_does_not_name_the_shape(library, path):
    secret = library.get(add_secret(library))
    kept = add(library, b"kept", "kept", "a")
    job_id = start_job(library, b"query", QueryRequest("moments", k=9))
    answer = ranking(secret, kept, classes=["label-of-it", "a"])
    library.remove(secret.id)
    assert end(library, job_id, "succeeded", result=answer).result == ranking(kept, classes=["a"])
    assert_no_secrets(path)


@pytest.mark.parametrize("state", ["succeeded", "failed", "cancelled"])
@pytest.mark.parametrize("request_", [QueryRequest(), ShapeRequest("a")], ids=["query", "shape"])
def test_the_mesh_of_a_job_without_a_shape_leaves_no_byte_on_disk(library, path, state, request_):
    job_id = start_job(library, LONG, request_)
    assert on_disk(path, SECRETS[0])
    end(library, job_id, state)
    assert_soon_gone(path, SECRETS[0])
    assert job_of(library, job_id).mesh_sha256 is None


def test_a_server_keeps_no_mesh_of_a_query_or_of_a_failed_upload(server):
    """The test sends a query and an upload that fails."""
    head, tail = small_mesh(77).split(b"element vertex", 1)
    query = head + b"comment MARK-OF-A-QUERY\nelement vertex" + tail
    broken = DAMAGED + b"# MARK-OF-A-FAILURE"
    with server.http() as http:
        answer = http.post("/v1/queries", files={"file": ("x.ply", query)}, headers={"Prefer": "wait=60"})
        assert answer.status_code == 200
        assert ended(http, post_mesh(http, broken, file_name="x.off"))["state"] == "failed"
    until = time.monotonic() + 20.0
    while b"MARK-OF-A" in in_files(server.library) and time.monotonic() < until:
        time.sleep(0.1)  # another reader may delay the erasure
    assert not on_disk(server.library, b"MARK-OF-A")


def test_pages_freed_without_overwriting_are_not_in_backups(library, path, tmp_path):
    shape_id = add_secret(library)
    library.close()
    with closing(sqlite3.connect(path, isolation_level=None)) as connection:
        connection.execute("PRAGMA secure_delete = OFF")
        for table, column in (("shapes", "id"), ("descriptors", "measure"), ("signatures", "id"), ("meshes", "sha256")):
            connection.execute(f"DELETE FROM {table} WHERE {column} IS NOT NULL")  # noqa: S608
    assert on_disk(path, SECRETS[0])
    with Library(str(path)) as again:
        again.backup(tmp_path / "copy.db")
        with pytest.raises(NotFoundError):
            again.get(shape_id)
    assert_no_secrets(tmp_path / "copy.db")
