"""Migrations that a caller asks for, or refuses: `unbend migrate`, and servers that may not migrate."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass

from alembic.runtime.migration import MigrationContext
from sqlalchemy import Connection

from unbend.errors import StoreOutdatedError, StoreVersionError
from unbend.library.storage import queue_schema, unfinished
from unbend.library.storage.database import latest_revision, open_reading_engine, opening, revisions
from unbend.library.storage.store import Store


@dataclass(frozen=True)
class Migration:
    """A migration of a library's schema, done or to be done."""

    before: str | None
    """The revision of the schema; None for an empty database."""
    after: str
    queue_steps: int
    """Number of steps that the tables of a cluster's queue need; 0 for SQLite."""

    @property
    def is_needed(self) -> bool:
        """Whether there is anything to do."""
        return self.before != self.after or self.queue_steps > 0


def plan_migration(url: str) -> Migration:
    """Return the migration that a library needs; this changes nothing.

    Parameters
    ----------
    url : str
        A path of an SQLite file, or an SQLAlchemy URL.

    Raises
    ------
    ParameterError
        If there is no such file.
    StoreVersionError
        If a later version of unbend made the library.
    StoreUnfinishedError
        If it is the target of a move that was interrupted.
    StoreError
        If it cannot be opened.
    """
    engine = open_reading_engine(url)
    try:
        with opening(engine.url), engine.connect() as connection:
            unfinished.refuse(connection)
            return Migration(revision_of(connection), latest_revision(), _queue_steps(connection))
    finally:
        engine.dispose()


def migrate(url: str) -> Migration:
    """Migrate a library to the schema of this version, and return what was done; raises as `plan_migration` does."""
    plan = plan_migration(url)
    if plan.is_needed:
        with closing(Store(url)):
            pass
    return plan


def must_be_migrated(url: str) -> Migration:
    """Raise StoreOutdatedError if a library needs a migration; other errors, and the result, as by `plan_migration`."""
    plan = plan_migration(url)
    if plan.before != plan.after:
        found = f"the schema {plan.before}" if plan.before else "no schema yet"
        raise StoreOutdatedError(f"the library has {found}, and this version needs {plan.after}")
    if plan.queue_steps:
        raise StoreOutdatedError("the tables of the library's queue are those of an earlier version")
    return plan


def revision_of(connection: Connection) -> str | None:
    """Return the revision of a database's schema; None if it is empty; StoreVersionError if it is unknown."""
    found = MigrationContext.configure(connection).get_current_revision()
    if found is not None and found not in revisions():
        raise StoreVersionError("the library was made by a later version of unbend")
    return found


def _queue_steps(connection: Connection) -> int:
    return len(queue_schema.missing_steps(connection)) if connection.dialect.name == "postgresql" else 0
