"""Verification of backups: damaged and malicious backups are refused with a message that names the fault."""

from __future__ import annotations

import random
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from tests.support.commands import in_process, succeeded
from tests.support.server import small_mesh
from tests.support.store import PARAMETERS, add
from unbend import Library, Parameters
from unbend.errors import UnbendError
from unbend.library import job_rows, shape_rows
from unbend.library.backups.backup import backup, restore, verify
from unbend.library.requests import QueryRequest, Upload

FEW = Parameters(samples=40)


@pytest.fixture(scope="module")
def sound(tmp_path_factory) -> Path:
    """A backup of a library with rows in every table."""
    folder = tmp_path_factory.mktemp("sound")
    with Library(str(folder / "library.db")) as library:
        shape = library.add(small_mesh(0), name="a", label="b", metadata={"c": [1]}, parameters=FEW)
        add(library, b"x" * 50_000, "made up")
        library.keys.create("a key", "write")
        with library.store.write() as connection:
            key = Upload(b"query", "off", PARAMETERS).key
            shape_rows.put_mesh(connection, key.sha256, b"query")
            job = job_rows.enqueue(
                connection, job_id=job_rows.new_id(), key=key, file_type="off", request=QueryRequest(k=1)
            )
            answer = library.rank(library.signature(shape.id), k=1).as_dict()
            job_rows.claim(connection)
            job_rows.finish(connection, job.id, "succeeded", result=answer)
        backup(library.url, folder / "backup.db")
    return folder / "backup.db"


HARM = {
    "a trigger that makes keys": (
        "CREATE TRIGGER t AFTER INSERT ON jobs BEGIN INSERT INTO api_keys VALUES ('x', 'x', 'x', 'x', 0, 0, 0, 0); END",
        "has a trigger, 't'",
    ),
    "a view": ("CREATE VIEW v AS SELECT 1", "has a view, 'v'"),
    "a view in place of a table": (
        "ALTER TABLE api_keys RENAME TO k; CREATE VIEW api_keys AS SELECT * FROM k",
        "has a view",
    ),
    "a missing table": ("DROP TABLE descriptors", "descriptors"),
    "a missing column": ("ALTER TABLE jobs DROP COLUMN warnings", "warnings"),
    "no state": ("DELETE FROM library_state", "library_state must have exactly one row"),
    "two states": ("INSERT INTO library_state (id, revision) VALUES (7, 1)", "library_state must have exactly one row"),
    "another mesh": ("UPDATE meshes SET data = zeroblob(length(data))", "is not the uploaded file"),
    "a mesh of another size": ("UPDATE meshes SET size = size + 1", "is not the uploaded file"),
    "metadata that is no JSON": ("UPDATE shapes SET metadata = '{'", "of shapes cannot be read"),
    "parameters that are none": ("UPDATE signatures SET parameters = '{\"samples\": 1}'", "row 1 of signatures"),
    "a policy that is none": ("UPDATE signatures SET policy = 'x'", "row 1 of signatures"),
    "a report that is none": ("UPDATE signatures SET report = '[]'", "a report that is not an object"),
    "a signature cut off": ("UPDATE signatures SET payload = substr(payload, 1, 100)", "no signature"),
    "a vector cut off": ("UPDATE descriptors SET vector = substr(vector, 1, 9)", "row 1 of descriptors"),
    "a vector that is text": ("UPDATE descriptors SET vector = 'x'", "a vector of the wrong type"),
    "a label that is a number": ("UPDATE shapes SET label = x'00'", "a label of the wrong type"),
    "an unknown state": ("UPDATE jobs SET state = 'done'", "an unknown state"),
    "a malformed result": ('UPDATE jobs SET result = \'{"shapes": [[1]], "classes": []}\'', "a malformed result"),
    "a job that waits for no mesh": (
        "UPDATE jobs SET state = 'queued', mesh_sha256 = NULL",
        "no mesh before its end",
    ),
    "a time beyond all times": ("UPDATE shapes SET created_at = 1e300", "created_at"),
    "a reference to nothing": ("PRAGMA foreign_keys = OFF; DELETE FROM signatures", "refers to nothing"),
    "an unknown scope": ("UPDATE api_keys SET scope = 'god'", "an unknown scope"),
}


def harmed(sound: Path, folder: Path, statement: str) -> Path:
    path = folder / "harmed.db"
    shutil.copy(sound, path)
    with closing(sqlite3.connect(path, isolation_level=None)) as connection:
        connection.executescript(statement)
    return path


def test_a_valid_backup_passes_verification_unchanged(sound):
    before = sound.read_bytes()
    done = succeeded("backup", sound, "--verify", run=in_process)
    assert "2 shapes" in done.stdout
    assert "sound" in done.stdout
    assert sound.read_bytes() == before
    assert [path.name for path in sound.parent.iterdir() if path.name.startswith(".")] == []


@pytest.mark.parametrize("name", HARM)
def test_a_manipulated_backup_is_refused_and_the_library_stays_unchanged(sound, tmp_path, name):
    statement, said = HARM[name]
    path = harmed(sound, tmp_path, statement)
    with Library(str(tmp_path / "library.db")) as library:
        kept = add(library, b"kept", "kept").id
    for refused in (
        in_process("backup", path, "--verify"),
        in_process("restore", path, "--library", tmp_path / "library.db", "--force"),
    ):
        assert refused.returncode == 1
        assert said in refused.stderr
        assert "Traceback" not in refused.stderr
    with Library(str(tmp_path / "library.db")) as library:
        assert [shape.id for shape in library.page().items] == [kept]
        with library.store.read() as connection:
            assert connection.exec_driver_sql("SELECT count(*) FROM api_keys").scalar_one() == 0


def test_foreign_indexes_and_statistics_are_not_restored(sound, tmp_path):
    path = harmed(sound, tmp_path, "CREATE INDEX mine ON shapes (name); ANALYZE")
    restore(path, str(tmp_path / "library.db"))
    with closing(sqlite3.connect(tmp_path / "library.db")) as connection:
        assert "mine" not in {name for (name,) in connection.execute("SELECT name FROM sqlite_master")}
    with Library(str(tmp_path / "library.db")) as library:
        assert len(library) == 2


@pytest.mark.parametrize("seed", range(40))
def test_a_backup_with_flipped_bits_is_refused_or_fully_readable(sound, tmp_path, seed):
    chance = random.Random(seed)  # noqa: S311
    data = bytearray(sound.read_bytes())
    for _ in range(1 + seed % 3):
        data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
    damaged = tmp_path / "damaged.db"
    damaged.write_bytes(data)
    try:
        verify(damaged)
        restore(damaged, str(tmp_path / "library.db"))
    except UnbendError:
        return
    with Library(str(tmp_path / "library.db")) as library:
        for shape in library.page().items:
            assert library.mesh(shape.id)
            assert library.signature(shape.id)
        with library.store.read() as connection:
            for job in job_rows.list_jobs(connection, job_rows.JobFilter(), cursor=None, limit=10).items:
                assert job_rows.get_job(connection, job.id)
