"""`unbend migrate`, and a server that may not migrate."""

from __future__ import annotations

import json
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
from sqlalchemy import text

from tests.support.commands import failed_with_a_sentence, in_process, succeeded
from unbend.library import Library
from unbend.library.storage.database import latest_revision, open_engine

RELEASED = Path(__file__).parent.parent / "library" / "released"


@pytest.fixture
def old(tmp_path) -> Path:
    """The path of a library of an older schema."""
    path = tmp_path / "old.db"
    with closing(sqlite3.connect(path)) as connection:
        connection.executescript((RELEASED / "0008.sql").read_text(encoding="utf-8"))
    return path


def test_a_check_fails_if_a_migration_is_needed_and_changes_nothing(old):
    before = old.read_bytes()
    failed_with_a_sentence(in_process("migrate", "--check", "--library", old), "schema 0008", latest_revision())
    assert old.read_bytes() == before


def test_a_migration_says_from_which_schema_to_which(old):
    done = succeeded("migrate", "--library", old, run=in_process)
    assert done.stdout == f"{old}: schema 0008 -> {latest_revision()}\n"
    again = succeeded("migrate", "--library", old, "--json", run=in_process)
    assert json.loads(again.stdout) == {
        "library": str(old), "before": latest_revision(), "after": latest_revision(), "migrated": False,
    }  # fmt: skip
    assert "nothing to do" in succeeded("migrate", "--check", "--library", old, run=in_process).stdout


def test_a_missing_library_is_not_made(tmp_path):
    for options in ([], ["--check"]):
        failed_with_a_sentence(in_process("migrate", "--library", tmp_path / "no.db", *options), "no library")
    assert list(tmp_path.iterdir()) == []


def test_a_library_of_a_later_version_is_refused(old):
    with closing(sqlite3.connect(old, isolation_level=None)) as connection:
        connection.execute("UPDATE alembic_version SET version_num = '9999'")
    for options in ([], ["--check"]):
        failed_with_a_sentence(in_process("migrate", "--library", old, *options), "a later version of unbend")


def test_a_server_that_may_not_migrate_refuses_an_older_schema(old):
    before = old.read_bytes()
    refused = in_process("serve", "--library", old, "--port", 0, UNBEND_MIGRATE="false")
    assert refused.returncode == 1
    assert "schema 0008" in refused.stderr
    assert "unbend migrate" in refused.stderr
    assert old.read_bytes() == before


def test_an_empty_database_becomes_a_library_and_an_older_queue_is_migrated(postgres):
    url = postgres.new()
    failed_with_a_sentence(in_process("migrate", "--check", "--library", url), "no schema yet")
    assert f"schema {latest_revision()}, new" in succeeded("migrate", "--library", url, run=in_process).stdout
    succeeded("migrate", "--check", "--library", url, run=in_process)
    engine = open_engine(url)
    with engine.begin() as connection:
        connection.execute(text("DROP TRIGGER unbend_job_changed ON jobs"))
        connection.execute(text("DELETE FROM queue_migrations WHERE name LIKE 'unbend%'"))
    engine.dispose()
    failed_with_a_sentence(in_process("migrate", "--check", "--library", url), "queue")
    assert "the queue was migrated" in succeeded("migrate", "--library", url, run=in_process).stdout
    with Library(url) as library, library.store.read() as connection:
        assert connection.scalar(text("SELECT count(*) FROM pg_trigger WHERE tgname = 'unbend_job_changed'")) == 1
    postgres.drop(url)
