"""Libraries of every released version, stored as dumps: this version opens and migrates all of them."""

from __future__ import annotations

import asyncio
import json
import shutil
import signal
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from tests.support.server import without_settings
from unbend import Library, MeshPolicy
from unbend.jobs.limits import JobLimits
from unbend.jobs.runner import JobRunner
from unbend.jobs.worker import StoredMesh, compute_query
from unbend.library import job_rows
from unbend.library.packing import unpack_signature
from unbend.library.requests import decode_request
from unbend.library.storage.database import revisions

RELEASED = Path(__file__).parent / "released"
DUMPS = sorted(path.stem for path in RELEASED.glob("*.sql"))
Rows = list[dict[str, object]]


def rows_of(path: Path, query: str) -> Rows:
    with closing(sqlite3.connect(path)) as connection:
        connection.row_factory = sqlite3.Row
        return [dict(row) for row in connection.execute(query)]


def schema(path: Path) -> dict[tuple[str, str], tuple[list[str], Rows]]:
    """Return every table and index: its columns in order, and its constraints in any order."""
    found = rows_of(path, "SELECT type, name, coalesce(sql, '') AS text FROM sqlite_master")
    lines = {(row["type"], row["name"]): [line.strip(" \t,") for line in row["text"].splitlines()] for row in found}
    return {key: (sorted(text), rows_of(path, f"PRAGMA table_info('{key[1]}')")) for key, text in lines.items()}


def everything(path: Path) -> dict[str, Rows]:
    tables = [name for kind, name in schema(path) if kind == "table" and name != "alembic_version"]
    return {table: rows_of(path, f"SELECT * FROM {table} ORDER BY 1, 2") for table in tables}  # noqa: S608


@pytest.fixture
def old(tmp_path, request) -> Path:
    """The path of a library of the revision that the test is parametrized with."""
    path = tmp_path / f"{request.param}.db"
    with closing(sqlite3.connect(path)) as connection:
        connection.executescript((RELEASED / f"{request.param}.sql").read_text(encoding="utf-8"))
    return path


@pytest.fixture(scope="module")
def fresh(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("fresh") / "new.db"
    with Library(str(path)):
        pass
    return path


def reading(old: Path) -> MeshPolicy:
    """Return the default policy of the version that wrote the library `old`."""
    return MeshPolicy(seams="stitch" if old.stem >= "0007" else "keep")


each = pytest.mark.parametrize("old", DUMPS, indirect=True)


def test_every_revision_of_the_schema_has_a_dump():
    assert set(DUMPS) == revisions()


@each
def test_a_migration_gives_the_current_schema_and_keeps_every_row(old, fresh):
    before = everything(old)
    assert len(before["shapes"]) == 2
    assert {row["state"] for row in before["jobs"]} == {"queued", "running", "succeeded", "failed", "cancelled"}
    with Library(str(old)):
        pass
    assert schema(old) == schema(fresh)
    assert rows_of(old, "PRAGMA integrity_check") == [{"integrity_check": "ok"}]
    assert rows_of(old, "PRAGMA foreign_key_check") == []
    after = everything(old)
    for table, rows in before.items():
        # the new table of labels adds a row to sqlite_sequence
        kept_rows = [row for row in after[table] if row.get("name") != "labels" or row in rows]
        for earlier, later in zip(rows, kept_rows, strict=True):
            kept = earlier.keys() - {"policy", "epoch"} - ({"result", "request"} if table == "jobs" else set())
            for column in kept:
                assert later[column] == earlier[column], (table, column)
            if "policy" in later:
                assert MeshPolicy.from_json(later["policy"]) == reading(old)


@each
def test_every_shape_of_an_old_library_can_be_read_searched_changed_and_removed(old):
    stored = rows_of(
        old,
        "SELECT shapes.*, meshes.data, payload FROM shapes JOIN signatures ON signatures.id = signature_id"
        " JOIN meshes ON meshes.sha256 = mesh_sha256 ORDER BY seq",
    )
    assert {row["label"] for row in stored} == {"pressed", "octahedron"}
    with Library(str(old)) as library:
        shapes = library.page().items
        for row, shape in zip(stored, shapes, strict=True):
            assert (shape.id, shape.name, shape.label, shape.seq) == tuple(
                row[key] for key in ("id", "name", "label", "seq")
            )
            assert (shape.metadata, shape.policy) == (json.loads(row["metadata"]), reading(old))
            assert shape.warnings == []
            assert shape.created_at.timestamp() == row["created_at"]
            assert library.mesh(shape.id) == row["data"]
            signature, written = library.signature(shape.id), unpack_signature(row["payload"], {})
            assert signature.points.shape == (6, 3)
            np.testing.assert_array_equal(signature.points, written.points)
            assert set(signature.descriptors) >= {"moments", "spectrum", "distribution"}
        one, other = shapes
        assert [match.id for match in library.nearest(one.id)] == [other.id]
        assert [match.label for match in library.classify(one.id)] == [other.label]
        assert library.nearest(library.signature(one.id), 1)[0].distance == 0.0
        assert library.change(one.id, label="new").label == "new"
        library.remove(one.id)
        assert library.page().items == [other]
        assert library.nearest(library.signature(other.id), 9)[0].id == other.id


_STORED = ("kind", "state", "stage", "progress", "attempts", "restarts", "seq", "mesh_sha256", "shape_id")


@each
def test_every_job_of_an_old_library_is_kept_and_queued_jobs_can_be_computed(old, tmp_path):
    reported = {row["id"]: row for row in rows_of(old, "SELECT * FROM jobs")}
    with Library(str(old)) as library:
        with library.store.read() as connection:
            jobs = [job_rows.get_job(connection, job_id) for job_id in reported]
        assert len(jobs) == len(reported) == 7
        for job in jobs:
            row = reported[job.id]
            for name in _STORED:
                assert getattr(job, name) == row[name]
            assert job.error == json.loads(row["error"] or "null")
            answer = json.loads(row["result"] or "null")
            if answer is not None and old.stem < "0008":  # since 0008, stored results refer to shapes and classes
                shapes = [shape | {"part": None} for shape in answer["shapes"]]  # earlier versions knew no parts
                assert job.result == answer | {"shapes": shapes}
            elif answer is None:
                assert job.result is None
            else:
                assert len(job.result["shapes"]) == len(answer["shapes"]) == 2
            assert job.request == (None if job.finished else decode_request(job.kind, json.loads(row["request"])))
            assert job.created_at.timestamp() == row["created_at"]
        with library.store.write() as connection:
            job = job_rows.claim(connection)
        mesh = StoredMesh(library.address, job.mesh_sha256, job.file_type, job.policy)
        assert compute_query(mesh, job.parameters).signature.points.shape == (6, 3)
        assert job.request.name == "waiting"


@pytest.mark.parametrize("old", ["0006"], indirect=True)
def test_the_migration_sets_the_seams_of_stl_files_to_stitch(old):
    with closing(sqlite3.connect(old)) as connection:
        connection.executescript(
            """UPDATE signatures SET report = replace(report, '"file_type": "off"', '"file_type": "stl"') WHERE id = 1;
            UPDATE jobs SET file_type = 'stl' WHERE seq = 1;"""
        )
    with Library(str(old)):
        pass
    for table, column in (("signatures", "id"), ("jobs", "seq")):
        policies = rows_of(old, f"SELECT policy FROM {table} ORDER BY {column}")  # noqa: S608
        assert [MeshPolicy.from_json(row["policy"]).seams for row in policies[:2]] == ["stitch", "keep"]


@pytest.mark.parametrize("old", [revision for revision in DUMPS if revision >= "0005"], indirect=True)
def test_a_migration_keeps_active_and_revoked_keys(old):
    with Library(str(old)) as library:
        assert {key.name: key.revoked_at is None for key in library.keys.all()} == {"live": True, "revoked": False}


@pytest.mark.parametrize("old", DUMPS[:1], indirect=True)
def test_unfinished_jobs_of_the_first_version_run_to_success(old):
    waiting = [row["id"] for row in rows_of(old, "SELECT id FROM jobs WHERE state IN ('queued', 'running')")]
    assert len(waiting) == 3

    async def run(library: Library) -> list[str]:
        runner = JobRunner(library, workers=1, limits=JobLimits(drain_seconds=0.0))
        await runner.start()
        try:
            return [(await runner.wait(job_id, 120.0)).state for job_id in waiting]
        finally:
            await runner.stop()

    with Library(str(old)) as library:
        assert asyncio.run(run(library)) == ["succeeded"] * 3
        assert {shape.name for shape in library.page().items} == {"flät/=1", "uploaded", "running", "waiting"}


CUT_OFF = """
import os, signal, sys
from sqlalchemy import Engine, event
from unbend import Library
left = int(sys.argv[2])
@event.listens_for(Engine, "after_cursor_execute")
def count(*call):
    global left
    left -= call[2].lstrip().split()[0] in {"CREATE", "ALTER", "INSERT", "UPDATE", "DROP"}
    if not left:
        os.kill(os.getpid(), signal.SIGKILL)
Library(sys.argv[1])
"""


@pytest.mark.parametrize(("old", "changes"), [("0001", 9), ("0005", 2)], indirect=["old"])
def test_a_killed_migration_keeps_the_old_library(old, tmp_path, changes):
    before, untouched = everything(old), tmp_path / "untouched.db"
    shutil.copy(old, untouched)
    killed = subprocess.run([sys.executable, "-c", CUT_OFF, old, str(changes)], env=without_settings(), check=False)
    assert killed.returncode == -signal.SIGKILL
    assert Path(f"{old}-wal").exists()  # the killed process did not close the database
    assert schema(old) == schema(untouched)
    assert everything(old) == before
    with Library(str(old)) as library:
        assert len(library) == 2
