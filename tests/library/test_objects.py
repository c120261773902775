"""Meshes in an object store: written before their rows, deleted after them, checked when they are read."""

from __future__ import annotations

import asyncio
import hashlib
import os
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from datetime import timedelta
from pathlib import Path

import pytest
from sqlalchemy import func, select

from tests.support.server import without_settings
from tests.support.store import PARAMETERS, signature
from unbend import Library, Parameters
from unbend.errors import (
    NotFoundError,
    ObjectDamagedError,
    ObjectMissingError,
    ObjectsUnavailableError,
    ParameterError,
)
from unbend.jobs.limits import JobLimits
from unbend.jobs.runner import JobRunner
from unbend.library.backups.backup import restore, verify
from unbend.library.jobs import ANONYMOUS, NewJob, QueueLimits
from unbend.library.packing import PackedSignature
from unbend.library.requests import ShapeRequest, Upload
from unbend.library.shape_rows import ComputedShape
from unbend.library.storage.objects import Objects
from unbend.library.storage.schema import meshes, object_deletions, object_writes
from unbend.library.sweeping import move, sweep, tidy

DATA = b"OFF\n4 4 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n"
SHA256 = hashlib.sha256(DATA).hexdigest()
NOW = timedelta(0)
LIMITS = QueueLimits(queued=100)


@pytest.fixture
def objects_url(database, tmp_path, request, monkeypatch) -> str:
    """The address of an empty object store: a folder for SQLite, and a bucket of a server for PostgreSQL."""
    if database == "sqlite":
        return f"file://{tmp_path}/objects"
    mock_s3 = request.getfixturevalue("mock_s3")
    for name, value in mock_s3.environment.items():
        monkeypatch.setenv(name, value)
    return mock_s3.new()


@pytest.fixture
def library(url, objects_url):
    with Library(url, objects=objects_url) as opened:
        yield opened


@pytest.fixture
def objects(library) -> Objects:
    return library.store.objects


def add(library: Library, data: bytes = DATA, parameters: Parameters = PARAMETERS) -> str:
    """Store a shape without computing a signature; return its id."""
    key = Upload(data, "off", parameters).key
    computed = ComputedShape(key, PackedSignature.of(signature()), area=1.0, report={"file_type": "off"})
    return library.shapes.submit(computed, ShapeRequest("shape"), lambda: data).result().id


def hashes(objects: Objects) -> set[str]:
    return {item.sha256 for folder in objects.folders() for item in objects.list(folder)}


def rows(library: Library) -> dict[str, bytes | None]:
    with library.store.read() as connection:
        return {row.sha256: row.data for row in connection.execute(select(meshes.c.sha256, meshes.c.data))}


def waiting(library: Library) -> tuple[int, int]:
    with library.store.read() as connection:
        tables = (object_writes, object_deletions)
        return tuple(connection.scalar(select(func.count()).select_from(table)) for table in tables)


def until_deleted(library: Library) -> None:
    """Wait for the queued deletions, which another thread may have claimed."""
    end = time.monotonic() + 10
    while library.store.deletions.run() or waiting(library) != (0, 0):
        assert time.monotonic() < end
        time.sleep(0.01)


def write_object(objects_url: str, data: bytes, sha256: str) -> None:
    """Put other bytes under a hash."""
    Objects(objects_url).put(sha256, data)


def test_a_mesh_is_in_the_object_store_and_not_in_the_database(library, objects, tmp_path):
    shape_id = add(library)
    assert rows(library) == {SHA256: None}
    assert hashes(objects) == {SHA256}
    assert library.mesh(shape_id) == DATA
    assert library.shapes.read_file(SHA256, 4, 5) == DATA[4:9]
    assert library.shapes.read_file(SHA256, len(DATA) - 3, 100) == DATA[-3:]
    assert library.export(tmp_path / "exported") == 1
    assert (tmp_path / "exported" / "shape.off").read_bytes() == DATA
    assert waiting(library) == (0, 0)


def test_the_address_of_an_object_is_its_hash(path, library, objects_url):
    add(library)
    folder = Path(objects_url.removeprefix("file://"))
    assert (folder / SHA256[:2] / SHA256[2:]).read_bytes() == DATA


def test_an_object_is_deleted_with_the_last_shape_that_needs_it(library, objects):
    first, second = add(library), add(library, parameters=Parameters(samples=50))
    library.remove(first)
    until_deleted(library)
    assert hashes(objects) == {SHA256}
    assert library.mesh(second) == DATA
    library.remove(second)
    until_deleted(library)
    assert hashes(objects) == set()
    with pytest.raises(NotFoundError):
        library.shapes.file(SHA256)


def test_closing_a_library_carries_out_its_deletions(url, objects_url):
    with Library(url, objects=objects_url) as library:
        library.remove(add(library))
    assert hashes(Objects(objects_url)) == set()


def test_a_process_without_the_address_leaves_the_deletion_to_another(url, objects_url):
    with Library(url, objects=objects_url) as library:
        shape_id = add(library)
    with Library(url) as library:
        with pytest.raises(ObjectsUnavailableError, match=f"mesh {SHA256} is in an object store") as found:
            library.mesh(shape_id)
        assert "UNBEND_OBJECTS" in found.value.advice
        library.remove(shape_id)
        assert waiting(library) == (0, 1)
    with Library(url, objects=objects_url) as library:
        assert tidy(library) == 1
    assert hashes(Objects(objects_url)) == set()


def test_an_upload_that_keeps_nothing_leaves_no_object(library, objects):
    parameters = Parameters(samples=60)
    full = QueueLimits(queued=0)
    with pytest.raises(Exception, match="0 jobs wait already"):
        library.jobs.submit_shape(Upload(DATA, "off", parameters), ShapeRequest("a"), ANONYMOUS, full).result()
    until_deleted(library)
    assert hashes(objects) == set()
    shape_id = add(library)
    known = library.jobs.submit_shape(Upload(DATA, "off", PARAMETERS), ShapeRequest("a"), ANONYMOUS, full).result()
    assert known.id == shape_id
    until_deleted(library)
    assert library.mesh(shape_id) == DATA


def test_a_query_needs_its_object_until_its_end(library, objects):
    submitted = library.jobs.submit_shape(Upload(DATA, "off"), ShapeRequest("a"), ANONYMOUS, LIMITS).result()
    assert isinstance(submitted, NewJob)
    until_deleted(library)
    assert library.shapes.file(SHA256) == DATA
    library.jobs.cancel(submitted.job.id, {"code": "c", "message": "m", "advice": ""}, None).result()
    until_deleted(library)
    assert hashes(objects) == set()


def test_a_whole_read_detects_other_bytes_and_missing_ones(library, objects, objects_url, tmp_path):
    shape_id = add(library)
    write_object(objects_url, DATA.replace(b"1", b"2"), SHA256)
    with pytest.raises(ObjectDamagedError, match=f"mesh {SHA256} in the object store has other bytes"):
        library.mesh(shape_id)
    with pytest.raises(ObjectDamagedError):
        library.export(tmp_path / "exported")
    objects.delete([SHA256])
    for read in (lambda: library.mesh(shape_id), lambda: library.shapes.read_file(SHA256, 0, 5)):
        with pytest.raises(ObjectMissingError, match=SHA256):
            read()


def test_a_store_that_refuses_or_does_not_answer_is_a_typed_error(tmp_path, mock_s3, monkeypatch):
    for name, value in mock_s3.environment.items():
        monkeypatch.setenv(name, value)
    with Library(str(tmp_path / "a.db"), objects=mock_s3.new()) as library:
        shape_id = add(library)
        mock_s3.refuse()
        try:
            for call in (lambda: library.mesh(shape_id), lambda: add(library, b"other")):
                with pytest.raises(ObjectsUnavailableError, match="refuses the credentials") as refused:
                    call()
                assert refused.value.retry_after > 0
        finally:
            mock_s3.accept()
        assert library.mesh(shape_id) == DATA
    monkeypatch.setenv("AWS_ENDPOINT", "http://127.0.0.1:9")
    with Library(str(tmp_path / "a.db"), objects="s3://bucket/prefix") as library:
        with pytest.raises(ObjectsUnavailableError, match="does not answer"):
            library.mesh(shape_id)
        assert library.get(shape_id).name == "shape"
    monkeypatch.setenv("AWS_ENDPOINT", mock_s3.address)
    with (
        Library(str(tmp_path / "a.db"), objects="s3://none/prefix") as library,
        pytest.raises(ObjectsUnavailableError, match="no such bucket"),
    ):
        add(library, b"other")
    with pytest.raises(ParameterError, match="begins with one of"):
        Library(str(tmp_path / "a.db"), objects="ftp://host/folder")


def test_meshes_move_between_the_database_and_the_object_store(url, objects_url):
    with Library(url) as library:
        old = add(library)
    other = b"# " + DATA
    with Library(url, objects=objects_url) as library:
        new = add(library, other)
        assert {key: value is None for key, value in rows(library).items()} == {
            SHA256: False,
            hashlib.sha256(other).hexdigest(): True,
        }
        assert add(library, parameters=Parameters(samples=70))  # the database has the same bytes
        until_deleted(library)
        assert SHA256 not in hashes(library.store.objects)
        assert (library.mesh(old), library.mesh(new)) == (DATA, other)
        assert library.shapes.read_file(SHA256, 2, 3) == DATA[2:5]
        assert list(move(library, "objects")) == [(SHA256, len(DATA))]
        assert set(rows(library).values()) == {None}
        assert (library.mesh(old), library.mesh(new)) == (DATA, other)
        assert len(list(move(library, "database"))) == 2
        assert hashes(library.store.objects) == set()
    with Library(url) as library:
        assert (library.mesh(old), library.mesh(new)) == (DATA, other)


def test_a_sweep_finds_objects_without_mesh_and_meshes_without_object(library, objects):
    kept, lost, orphan = b"kept", b"lost", b"orphan"
    add(library, kept), add(library, lost)
    names = {data: hashlib.sha256(data).hexdigest() for data in (kept, lost, orphan)}
    objects.put(names[orphan], orphan)
    objects.delete([names[lost]])
    found = sweep(library, grace=timedelta(hours=1))
    assert (found.objects, found.orphans, found.missing) == (2, [], [names[lost]])
    found = sweep(library, grace=NOW)
    assert (found.orphans, found.orphan_size, found.deleted) == ([names[orphan]], 6, 0)
    assert names[orphan] in hashes(objects)
    assert sweep(library, grace=NOW, delete=True).deleted == 1
    assert hashes(objects) == {names[kept]}


def test_a_sweep_spares_the_object_of_an_upload_under_way(library, objects):
    gates = Gates(objects, "put")
    library.store.objects = gates
    with ThreadPoolExecutor() as threads:
        adding = threads.submit(add, library)
        gates.reached.wait(10)
        found = sweep(library, grace=NOW, delete=True)
        assert (found.objects, found.orphans) == (1, [])
        gates.open.set()
        assert library.mesh(adding.result()) == DATA


class Gates:
    """An object store whose next calls of one method stop before, or after, the real call until they may go on."""

    def __init__(self, objects: Objects, method: str, *, before: bool = False) -> None:
        self._objects, self._method, self._before = objects, method, before
        self.reached, self.open = threading.Event(), threading.Event()
        self.puts = 0

    def __getattr__(self, name):
        real = getattr(self._objects, name)

        def call(*arguments):
            self.puts += name == "put"
            if name != self._method:
                return real(*arguments)
            if self._before:
                self._stop()
                return real(*arguments)
            result = real(*arguments)
            self._stop()
            return result

        return call

    def _stop(self) -> None:
        self.reached.set()
        assert self.open.wait(10)


@pytest.fixture
def other(url, objects_url):
    """A second process's view of the same library."""
    with Library(url, objects=objects_url) as opened:
        yield opened


def test_an_upload_waits_for_the_deletion_of_the_same_bytes(library, other, objects):
    """The deletion has decided, but not deleted yet: the upload must not believe that the object stays."""
    library.remove(add(library))
    until_deleted(library)
    removed = add(library)
    gates = Gates(objects, "delete", before=True)
    library.store.deletions._objects = gates
    with ThreadPoolExecutor() as threads:
        library.remove(removed)  # its thread stops before the object goes
        assert gates.reached.wait(10)
        adding = threads.submit(add, other)
        with pytest.raises(TimeoutError):
            adding.result(timeout=0.3)
        gates.open.set()
        assert other.mesh(adding.result()) == DATA
    until_deleted(library)
    assert hashes(objects) == {SHA256}


def test_a_removal_spares_the_object_that_an_upload_has_put(library, other, objects):
    """The upload has put its object, and not committed yet; meanwhile the last shape with these bytes is removed."""
    first = add(library)
    other.store.objects = gates = Gates(objects, "put")
    with library.store.read() as connection:
        assert connection.scalar(select(func.count()).select_from(meshes)) == 1
    with ThreadPoolExecutor() as threads:
        library.remove(first)
        until_deleted(library)
        adding = threads.submit(add, other)
        assert gates.reached.wait(10)
        second = add(library, parameters=Parameters(samples=80))
        library.remove(second)
        library.store.deletions.run()
        assert hashes(objects) == {SHA256}
        gates.open.set()
        assert other.mesh(adding.result()) == DATA
    until_deleted(library)
    assert hashes(objects) == {SHA256}


def test_a_removal_spares_the_object_that_an_upload_has_found(library, other, objects, monkeypatch):
    """The upload found the object of a shape, so it put none; the shape is removed before the upload commits."""
    first = add(library)
    begun, go_on = threading.Event(), threading.Event()
    begin = other.files._begin

    def stopped(token, sha256):
        size = begin(token, sha256)
        begun.set()
        assert go_on.wait(10)
        return size

    monkeypatch.setattr(other.files, "_begin", stopped)
    other.store.objects = gates = Gates(objects, "none")
    with ThreadPoolExecutor() as threads:
        adding = threads.submit(add, other)
        assert begun.wait(10)
        library.remove(first)
        library.store.deletions.run()
        go_on.set()
        assert other.mesh(adding.result()) == DATA
    assert gates.puts == 0
    until_deleted(library)
    assert hashes(objects) == {SHA256}


def test_additions_and_removals_of_the_same_bytes_leave_no_gap(library, other, objects):
    faults = []

    def work(place: Library, seed: int) -> None:
        for number in range(6):
            parameters = Parameters(samples=100 + (seed + number) % 3)
            shape_id = add(place, parameters=parameters)
            try:
                if place.mesh(shape_id) != DATA:
                    faults.append("other bytes")
                place.remove(shape_id)
            except NotFoundError:  # the other thread removed it
                continue
            except ObjectMissingError as error:
                faults.append(str(error))

    with ThreadPoolExecutor() as threads:
        list(threads.map(work, [library, library, other, other], range(4)))
    assert faults == []
    until_deleted(library)
    assert {sha256 for sha256, data in rows(library).items() if data is None} == hashes(objects) == set()
    assert waiting(library) == (0, 0)


KILLED = """
import os, signal, sys
from tests.library.test_objects import CRASHES, add
from unbend import Library
from unbend.library.storage.objects import Objects

def run(method, moment, data):
    real = getattr(Objects, method)
    def killed(self, *arguments):
        if moment == "after":
            real(self, *arguments)
        os.kill(os.getpid(), signal.SIGKILL)
    library = Library(sys.argv[1], objects=sys.argv[2])
    if method == "delete":
        shape = add(library, data)
    setattr(Objects, method, killed)
    library.remove(shape) if method == "delete" else add(library, data)
    library.close()

for crash in CRASHES:
    child = os.fork()
    if not child:
        run(*crash)
        os._exit(0)
    print(os.waitpid(child, 0)[1])
"""
CRASHES = (
    ("put", "before", b"no object"),
    ("put", "after", b"an object without a row"),
    ("delete", "before", b"an object whose row is gone"),
    ("delete", "after", b"neither"),
)


def test_killed_processes_leave_nothing_that_the_next_one_does_not_mend(url, objects_url, monkeypatch):
    environment = without_settings(PYTHONPATH=os.pathsep.join(sys.path))
    command = [sys.executable, "-c", KILLED, url, objects_url]
    ended = subprocess.run(command, env=environment, check=True, capture_output=True, text=True).stdout
    assert ended.split() == [str(int(signal.SIGKILL))] * len(CRASHES)
    with Library(url, objects=objects_url) as library:
        assert len(library) == 0
        assert hashes(library.store.objects) == {hashlib.sha256(CRASHES[number][2]).hexdigest() for number in (1, 2)}
        found = sweep(library, grace=NOW)
        assert (found.orphans, found.missing) == ([], [])  # the database knows of both
        monkeypatch.setattr("unbend.library.storage.object_rows.CLAIM_SECONDS", 0.0)
        tidy(library, longest=NOW)
        until_deleted(library)
        assert hashes(library.store.objects) == set()
        for _, _, data in CRASHES:
            assert library.mesh(add(library, data)) == data


def test_a_job_returns_to_the_queue_while_its_object_is_missing(path, library, objects):
    limits = JobLimits(drain_seconds=0.0, restarts=2)

    async def run() -> list[tuple[str, str | None]]:
        runner = JobRunner(library, workers=1, limits=limits, with_parts=False)
        uploads = [Upload(DATA + b"# %d" % number, "off", Parameters(samples=4)) for number in range(2)]
        jobs = [await runner.submit_shape(upload, ShapeRequest("a")) for upload in uploads]
        objects.delete([upload.key.sha256 for upload in uploads])
        await runner.start()
        try:
            while not (await runner.status(jobs[0].id)).restarts:
                await asyncio.sleep(0.05)
            await asyncio.to_thread(objects.put, uploads[0].key.sha256, uploads[0].data)
            ended = [await runner.wait(job.id, 60.0) for job in jobs]
            return [(job.state, job.error and job.error["code"]) for job in ended]
        finally:
            await runner.stop()

    assert asyncio.run(run()) == [("succeeded", None), ("failed", "object_missing")]


def test_a_backup_has_the_rows_but_not_the_objects(path, library, tmp_path):
    add(library)
    made = library.backup(tmp_path / "backup.db")
    assert (made.shapes, made.elsewhere) == (1, 1)
    assert verify(tmp_path / "backup.db").elsewhere == 1
    assert restore(tmp_path / "backup.db", str(tmp_path / "restored.db")).elsewhere == 1
    with sqlite3.connect(tmp_path / "backup.db") as connection:
        connection.execute("UPDATE meshes SET size = -1")
    connection.close()
    with pytest.raises(Exception, match="malformed"):
        verify(tmp_path / "backup.db")


def test_a_library_in_memory_has_no_object_store():
    with pytest.raises(ParameterError, match="in memory"):
        Library("sqlite://", objects="file:///tmp")
