"""Moves of a library between databases: equal rows and answers, interruptions, refusals, and damaged rows."""

from __future__ import annotations

import asyncio
import shutil
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import JSON, text

from tests.library.released.make import FEW, LIMITS, octahedron
from tests.support.commands import failed_with_a_sentence, in_process, succeeded
from tests.support.server import without_settings
from tests.support.store import add
from unbend import Library
from unbend.errors import (
    BackupError,
    ExistsError,
    MoveError,
    ParameterError,
    StoreInUseError,
    StoreOutdatedError,
    StoreUnfinishedError,
)
from unbend.jobs.limits import JobLimits
from unbend.jobs.runner import JobRunner
from unbend.library.jobs import Sender
from unbend.library.moving.move import Progress, move_library
from unbend.library.records import JobFile
from unbend.library.requests import FileRequest, QueryRequest, Upload
from unbend.library.storage.database import open_engine
from unbend.library.storage.lease import Lease
from unbend.library.storage.schema import metadata

RELEASED = Path(__file__).parent / "released"
SENT = Sender(owner="0123456789ab", idempotency="i" * 64, fingerprint="f" * 64, callback="https://example.org/")
Rows = dict[str, list[dict[str, Any]]]


@pytest.fixture(scope="module")
def original(tmp_path_factory) -> str:
    """A library in SQLite with rows in every table; the newest shape was removed."""
    path = tmp_path_factory.mktemp("original") / "library.db"
    with closing(sqlite3.connect(path)) as connection:
        connection.executescript(max(RELEASED.glob("*.sql")).read_text(encoding="utf-8"))
    with Library(str(path)) as library:
        shape = library.page().items[0]
        file = FileRequest("mesh", {"file_type": "ply"}, "ply", "flät.ply")
        library.jobs.submit_file(shape, file, Sender("0123456789ab"), LIMITS).result()
        job = library.jobs.claim().result()
        library.jobs.complete_file(job, JobFile("ply", "flät.ply", bytes(range(256)))).result()
        library.jobs.submit_query(Upload(octahedron(2.0), "off", FEW), QueryRequest(), SENT, LIMITS).result()
        library.remove(add(library, b"newest", "newest").id)
    execute(str(path), "INSERT INTO object_writes VALUES (lower(hex(zeroblob(16))), lower(hex(zeroblob(32))), 1.5)")
    execute(str(path), "INSERT INTO object_deletions VALUES (lower(hex(zeroblob(32))), 2.5, NULL, NULL)")
    return str(path)


@pytest.fixture
def source(original, tmp_path) -> str:
    """A copy of the original."""
    return str(shutil.copy(original, tmp_path / "source.db"))


@pytest.fixture(params=["sqlite", "postgresql"])
def target(request, tmp_path) -> str:
    """The address of a target of each kind: no file, and an empty library."""
    return str(tmp_path / "target.db") if request.param == "sqlite" else request.getfixturevalue("postgres_url")


@pytest.fixture
def file(tmp_path) -> str:
    """The path of a target that does not exist yet."""
    return str(tmp_path / "target.db")


def execute(url: str, statement: str) -> None:
    engine = open_engine(url)
    with engine.begin() as connection:
        connection.execute(text(statement))
    engine.dispose()


def everything(url: str) -> Rows:
    """Return the rows of every table, in an order that every database has: JSON as text, times as seconds."""
    engine = open_engine(url)
    found: Rows = {}
    with engine.connect() as connection:
        for defined in metadata.sorted_tables:
            columns = [
                f"CAST({each.name} AS TEXT) AS {each.name}" if isinstance(each.type, JSON) else each.name
                for each in defined.columns
            ]
            rows = connection.execute(text(f"SELECT {', '.join(columns)} FROM {defined.name}")).mappings()  # noqa: S608
            found[defined.name] = sorted((dict(row) for row in rows), key=repr)
    engine.dispose()
    return found


def moved(rows: Rows) -> Rows:
    """Return the rows that a move makes of others, but for the epoch: jobs that ran are queued."""
    queued = {"state": "queued", "stage": "queued", "started_at": None, "ticket": None}
    jobs = [
        row | queued | {"attempts": row["attempts"] - 1} if row["state"] == "running" else row for row in rows["jobs"]
    ]
    return rows | {"jobs": sorted(jobs, key=repr)}


def without_epoch(rows: Rows) -> Rows:
    return rows | {"library_state": [row | {"epoch": ""} for row in rows["library_state"]]}


class StoppedError(Exception):
    """A test stops a move."""


def stop_at(name: str):
    """Return a callback of progress that stops a move within a table."""

    def stop(progress: Progress) -> None:
        if progress.table == name and progress.rows:
            raise StoppedError

    return stop


def interrupted(source: str, target: str, name: str) -> None:
    """Move a library until one row of a table is at the target."""
    with pytest.raises(StoppedError):
        move_library(source, target, progress=stop_at(name), batch_bytes=1)


def test_every_table_of_the_original_has_rows(original):
    assert [name for name, rows in everything(original).items() if not rows] == []


def test_a_library_keeps_every_value_of_every_row_in_both_directions(source, target, tmp_path):
    before = everything(source)
    there = move_library(source, target)
    assert (there.copied, there.requeued) == (sum(there.rows.values()), 1)
    assert {name: len(rows) for name, rows in before.items() if name != "library_state"} == there.rows
    assert without_epoch(everything(target)) == without_epoch(moved(before))
    back = move_library(target, str(tmp_path / "back.db"))
    assert (back.rows, back.requeued) == (there.rows, 0)
    assert without_epoch(everything(str(tmp_path / "back.db"))) == without_epoch(moved(before))
    epochs = {everything(url)["library_state"][0]["epoch"] for url in (source, target, str(tmp_path / "back.db"))}
    assert len(epochs) == 3
    assert everything(source) == before


def test_callers_find_the_same_library(source, target):
    move_library(source, target)
    with Library(source) as old, Library(target) as new:
        first, second = old.page().items
        assert new.page().items == [first, second]
        assert new.page(cursor=old.page(limit=1).next_cursor).items == [second]
        for measure in ("spectrum", "moments"):
            assert new.rank(first.id, measure=measure) == old.rank(first.id, measure=measure)
        assert new.mesh(first.id) == old.mesh(first.id)
        assert [(key.id, key.name, key.revoked_at) for key in new.keys.all()] == [
            (key.id, key.name, key.revoked_at) for key in old.keys.all()
        ]
        finished = {job.id: job for job in old.list_jobs() if job.state not in {"running", "queued"}}
        assert {job.id: job for job in new.list_jobs() if job.id in finished} == finished
        (file,) = [job_id for job_id, job in finished.items() if job.kind == "file"]
        assert asyncio.run(new.jobs.file(asyncio.run(new.jobs.get(file)))).data == bytes(range(256))
        again = Upload(octahedron(2.0), "off", FEW)
        repeated = [each.jobs.submit_query(again, QueryRequest(), SENT, LIMITS).result() for each in (old, new)]
        assert repeated[0].id == repeated[1].id


def test_a_seq_of_a_removed_shape_or_job_does_not_come_again(source, target):
    with Library(source) as old:
        gone = add(old, b"gone", "gone")
        old.remove(gone.id)
    move_library(source, target)
    with Library(target) as new:
        assert add(new, b"new", "new").seq == gone.seq + 1
        last = max(row["seq"] for row in everything(source)["jobs"])
        sent = new.jobs.submit_query(Upload(b"a", "off", FEW), QueryRequest(), Sender(), LIMITS).result()
        assert sent.job.seq == last + 1


async def run_queued(library: Library) -> list[str]:
    waiting = [job.id for job in library.list_jobs() if job.state == "queued"]
    runner = JobRunner(library, workers=1, limits=JobLimits(drain_seconds=0.0))
    await runner.start()
    try:
        return [(await runner.wait(job_id, 60.0)).state for job_id in waiting]
    finally:
        await runner.stop()


def test_queued_jobs_run_at_the_target_and_ended_ones_do_not(source, postgres_url, tmp_path):
    ended = [row for row in everything(source)["jobs"] if row["state"] not in {"running", "queued"}]
    move_library(source, postgres_url)
    back = str(tmp_path / "back.db")
    move_library(postgres_url, back)
    with Library(postgres_url) as library:
        assert asyncio.run(run_queued(library)) == ["succeeded"] * 4
    after = {row["seq"]: row for row in everything(postgres_url)["jobs"]}
    assert [after[row["seq"]] for row in ended] == ended
    with Library(back) as library:
        claimed = [library.jobs.claim().result().seq for _ in range(4)]
        assert sorted(claimed) == sorted(seq for seq, row in after.items() if row not in ended)
        assert library.jobs.claim().result() is None


KILLED = """
import os, random, signal, sys, threading
from unbend.library.moving.move import move_library
source, target, seed = sys.argv[1:]
chance, kills, left = random.Random(int(seed)), 0, 0
def work_on(progress):
    global left
    left -= 1
    if not left:  # a random time later, this process is dead
        threading.Timer(chance.uniform(0, 0.005), os.kill, (os.getpid(), signal.SIGKILL)).start()
while True:
    left = chance.randrange(10, 30) * (kills + 1) if kills < 4 else 0
    child = os.fork()  # a fork needs no time for imports
    if not child:
        done = move_library(source, target, progress=work_on, batch_bytes=1)
        print(kills, done.copied, sum(done.rows.values()), flush=True)
        os._exit(0)
    _, status = os.waitpid(child, 0)
    if not os.WIFSIGNALED(status):
        sys.exit(os.waitstatus_to_exitcode(status))
    kills += 1
"""


def test_a_move_that_is_killed_goes_on_where_it_was(source, target):
    with Library(source) as library:
        for number in range(10):
            add(library, b"%d" % number, str(number), vector=(number, 0, 0))
    before = everything(source)
    command = [sys.executable, "-c", KILLED, source, target, "20"]
    done = subprocess.run(command, env=without_settings(), capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 0, done.stderr
    kills, copied, rows = map(int, done.stdout.split())
    assert kills >= 3
    assert 0 <= copied < rows
    assert without_epoch(everything(target)) == without_epoch(moved(before))


def test_an_unfinished_target_does_not_open_as_a_library(source, target):
    interrupted(source, target, "jobs")
    with pytest.raises(StoreUnfinishedError, match="unfinished") as raised:
        Library(target)
    assert "again" in raised.value.advice
    with pytest.raises(StoreUnfinishedError):
        move_library(target, source + "-other")
    assert move_library(source, target).copied > 0
    with Library(target) as library:
        assert len(library) == 2


def test_a_move_that_is_complete_changes_nothing_if_it_is_repeated(source, file):
    move_library(source, file)
    before = everything(file)
    assert move_library(source, file).copied == 0
    assert everything(file) == before


def test_a_target_that_holds_anything_else_is_refused_and_stays_unchanged(source, target):
    with Library(target) as library:
        add(library, b"mine", "mine")
    before = everything(target)
    with pytest.raises(ExistsError, match="not empty, and not the same library"):
        move_library(source, target)
    assert everything(target) == before


def test_the_target_of_another_move_is_refused(source, target, tmp_path):
    interrupted(source, target, "jobs")
    other = str(tmp_path / "other.db")
    with Library(other) as library:
        add(library, b"other", "other")
    before = everything(target)
    with pytest.raises(StoreUnfinishedError, match="another library"):
        move_library(other, target)
    assert everything(target) == before


def test_a_database_of_another_program_is_refused_and_stays_unchanged(source, tmp_path, postgres):
    path = tmp_path / "others.db"
    with closing(sqlite3.connect(path)) as connection:
        connection.executescript("CREATE TABLE birds (name); INSERT INTO birds VALUES ('wren')")
    before = path.read_bytes()
    others = postgres.new()
    execute(others, "CREATE TABLE birds (name text)")
    for target in (str(path), others):
        with pytest.raises(ExistsError, match="has a table birds"):
            move_library(source, target)
    assert path.read_bytes() == before
    (tmp_path / "letter.txt").write_text("no database")
    refused = in_process("migrate-library", source, tmp_path / "letter.txt")
    failed_with_a_sentence(refused, "letter.txt", "not a database")
    assert (tmp_path / "letter.txt").read_text() == "no database"


def test_a_library_is_not_moved_to_itself(source, file):
    move_library(source, file)
    for url in (source, file):
        with pytest.raises(ParameterError, match="is the source itself"):
            move_library(url, url)


def test_a_library_that_a_server_uses_is_refused(source, target, tmp_path):
    with Lease(source), pytest.raises(StoreInUseError, match="runs the jobs"):
        move_library(source, target)
    move_library(source, target)
    used = Lease(target) if "://" not in target else Library(target)
    with used as held:
        if isinstance(held, Library):
            assert len(held) == 2
        with pytest.raises(StoreInUseError) as raised:
            move_library(target, str(tmp_path / "third.db"))
        assert "Stop its servers" in raised.value.advice
    assert not (tmp_path / "third.db").exists()


def test_a_source_that_changes_during_the_move_is_noticed(source, file):
    def change(progress: Progress) -> None:
        if progress.table == "shapes" and progress.rows:
            with closing(sqlite3.connect(source, isolation_level=None)) as connection:
                connection.execute("UPDATE library_state SET revision = revision + 1")

    with pytest.raises(Exception, match="changed while it was copied"):
        move_library(source, file, progress=change)
    assert move_library(source, file).copied == 0


def test_a_source_of_an_older_schema_is_refused_and_stays_unchanged(tmp_path, target):
    path = tmp_path / "old.db"
    with closing(sqlite3.connect(path)) as connection:
        connection.executescript((RELEASED / "0008.sql").read_text(encoding="utf-8"))
    before = path.read_bytes()
    with pytest.raises(StoreOutdatedError, match="schema 0008"):
        move_library(str(path), target)
    assert path.read_bytes() == before


DAMAGE = {
    "shapes": "UPDATE shapes SET created_at = created_at + 0.000001",
    "jobs": "UPDATE jobs SET result = '{}' WHERE state = 'failed'",
}


@pytest.mark.parametrize("name", DAMAGE)
def test_a_row_that_was_damaged_at_the_target_is_named(source, target, name):
    interrupted(source, target, "shapes")
    execute(target, DAMAGE[name])
    with pytest.raises(MoveError, match=rf"row of {name} with seq \d+ is different at the target"):
        move_library(source, target)


def test_a_damaged_source_is_refused(source, file):
    execute(source, "UPDATE meshes SET data = zeroblob(length(data))")
    with pytest.raises(BackupError, match="is not the uploaded file"):
        move_library(source, file)
    assert not Path(file).exists()


def test_a_damaged_file_in_postgresql_is_named(source, postgres_url, tmp_path):
    move_library(source, postgres_url)
    execute(postgres_url, "UPDATE meshes SET data = '\\x00'")
    with pytest.raises(MoveError, match=r"row of meshes with sha256 .* is damaged"):
        move_library(postgres_url, str(tmp_path / "back.db"))


@pytest.mark.parametrize(
    ("statement", "said"),
    [
        ("UPDATE shapes SET name = 'a' || char(0) WHERE seq = 1", "row of shapes with seq 1 .*: its name has a NUL"),
        ("UPDATE shapes SET metadata = '{\"a\": NaN}' WHERE seq = 1", "row of shapes with seq 1 .*: invalid input"),
        ("UPDATE jobs SET restarts = 3000000000 WHERE seq = 2", "row of jobs with seq 2 .*: .*out of range"),
    ],
)
def test_a_value_that_postgresql_does_not_store_is_named(source, postgres_url, statement, said):
    execute(source, statement)
    with pytest.raises(MoveError, match=said):
        move_library(source, postgres_url)
    execute(source, "UPDATE shapes SET name = 'corrected', metadata = '{}', label = NULL")
    execute(source, "UPDATE jobs SET restarts = 0")
    move_library(source, postgres_url)


def test_a_library_is_moved_to_a_database_without_tables(source, postgres):
    url = postgres.new()
    assert move_library(source, url).rows["shapes"] == 2
    with Library(url, migrate=False) as library:
        assert len(library) == 2
    postgres.drop(url)


def test_files_that_are_read_in_pieces_arrive_whole(source, postgres_url, tmp_path):
    files = [b"ab" * 2**21, b"cd" * (2**22 + 1)]  # one piece of PostgreSQL's, and two and a bit
    with Library(source) as library:
        for data in files:
            add(library, data, "large")
    move_library(source, postgres_url)
    move_library(postgres_url, str(tmp_path / "back.db"))
    with Library(str(tmp_path / "back.db")) as library:
        assert [library.mesh(shape.id) for shape in library.page(name="large").items] == files


def test_the_command_reports_lines_in_a_pipe_and_one_document(source, target):
    done = succeeded("migrate-library", source, target, run=in_process)
    assert "2 shapes" in done.stdout
    assert "shapes: 2 rows" in done.stderr.splitlines()
    again = succeeded("migrate-library", source, target, "--json", "--quiet", run=in_process)
    assert '"copied": 0' in again.stdout
    assert again.stderr == ""


def test_passwords_are_not_printed(source):
    refused = in_process("migrate-library", source, "postgresql://me:secret@127.0.0.1:1/shapes")
    failed_with_a_sentence(refused, "cannot be opened")
    assert "secret" not in refused.stderr


def test_a_library_whose_files_are_in_an_object_store_is_moved_without_them(tmp_path, target):
    objects = f"file://{tmp_path}/objects"
    file = tmp_path / "with-objects.db"
    with Library(str(file), objects=objects) as library:
        shape = library.add(octahedron(1.7), parameters=FEW)
    move_library(str(file), target)
    with Library(target, objects=objects) as moved:
        assert moved.mesh(shape.id) == octahedron(1.7)
        assert moved.page().items == [shape]
