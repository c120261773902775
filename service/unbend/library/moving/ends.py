"""The two ends of a move: the library that is read, and the database that it is moved to."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

from sqlalchemy import Connection, Engine, Table, exists, inspect, select

from unbend.brief import counted
from unbend.errors import ExistsError, ParameterError, StoreInUseError, StoreUnfinishedError
from unbend.library.storage import postgres, unfinished
from unbend.library.storage.database import (
    is_in_memory,
    is_shared,
    latest_revision,
    migrate_engine,
    must_exist,
    open_engine,
    open_reading_engine,
    opening,
    shown_url,
    sqlite_file,
)
from unbend.library.storage.lease import Lease
from unbend.library.storage.migration import must_be_migrated, revision_of
from unbend.library.storage.schema import library_state, metadata
from unbend.library.vector_rows import drop_vectors, has_vectors

TABLES: Final[tuple[Table, ...]] = tuple(table for table in metadata.sorted_tables if table is not library_state)
"""The tables whose rows are copied, in an order in which each row follows those that it refers to."""

State = Literal["new", "unfinished", "full"]
"""The target is empty, has a part of the library that an earlier run copied, or is a library with rows."""

_ENDING_SECONDS: Final = 15.0
"""Time for the sessions of a killed run to end. PostgreSQL notices within 10 seconds that their process has died."""

_CLOSING_SECONDS: Final = 1.0
"""Time for the sessions of a command that has ended: PostgreSQL removes them from its list a little later."""

_LOOK_SECONDS: Final = 0.05
_STOP: Final = "Stop its servers and workers first: what they store after the copy would be lost."


@dataclass(frozen=True)
class End:
    """A database that is open for a move."""

    engine: Engine
    connection: Connection
    path: Path | None
    """The file of an SQLite database."""


@contextmanager
def opened_source(url: str) -> Iterator[End]:
    """Open the library that is moved. All transactions of the connection only read; the library stays unchanged.

    Raises
    ------
    ParameterError
        If there is no such library, or it is in memory.
    StoreInUseError
        If a server or a worker uses it.
    StoreOutdatedError
        If it has an older schema.
    """
    _must_last(url)
    must_exist(url)
    must_be_migrated(url)
    engine = open_engine(url)
    reading = postgres.one_state(engine) if is_shared(url) else engine.execution_options(unbend_reading=True)
    with _opened(url, reading) as end:
        yield end


@contextmanager
def opened_target(url: str) -> Iterator[End]:
    """Open the database that a library is moved to; raises as `opened_source` does, except for an older schema."""
    _must_last(url)
    with _opened(url, open_engine(url)) as end:
        yield end


def inspect_target(url: str, epoch: str) -> State:
    """Return what is at the target of a move from the library with this epoch; this changes nothing.

    Raises
    ------
    ParameterError
        If it is in memory, or is the source itself; ExistsError if it is no library.
    StoreUnfinishedError
        If a part of another library is there, or one that an earlier version of unbend copied.
    StoreError
        If it cannot be opened; StoreVersionError if a later version of unbend made it.
    """
    _must_last(url)
    if not is_shared(url) and not sqlite_file(url).exists():
        return "new"
    engine = open_reading_engine(url)
    try:
        with opening(engine.url), engine.connect() as connection:
            return _inspect(connection, shown_url(url), epoch)
    finally:
        engine.dispose()


def prepare_target(end: End, epoch: str) -> None:
    """Create or migrate the schema of an empty target, and mark the target as unfinished.

    Tables of vectors, which repeat what other tables have, are dropped: they can be made again afterwards.
    """
    migrate_engine(end.engine)
    with end.connection.begin():
        if has_vectors(end.connection):
            drop_vectors(end.connection)
        unfinished.begin(end.connection, epoch)


def _inspect(connection: Connection, name: str, epoch: str) -> State:
    tables = set(inspect(connection).get_table_names())
    revision = revision_of(connection)
    if revision is None:
        if tables:
            raise ExistsError(f"{name} has a table {min(tables)}, and is no library").with_advice(
                "Name a new, empty database."
            )
        return "new"
    origin = unfinished.origin(connection)
    if origin is not None and (origin, revision) != (epoch, latest_revision()):
        raise StoreUnfinishedError(f"{name} is unfinished: another library, or another version, was moved to it")
    if origin is not None:
        return "unfinished"
    if library_state.name in tables and _epoch(connection) == epoch:
        raise ParameterError(f"{name} is the source itself, or a copy of it").with_advice("Name a new, empty database.")
    present = [table for table in TABLES if table.name in tables]
    has_rows = any(connection.scalar(select(exists(select(1).select_from(table)))) for table in present)
    return "full" if has_rows else "new"


def _epoch(connection: Connection) -> str | None:
    columns = {each["name"] for each in inspect(connection).get_columns(library_state.name)}
    return connection.scalar(select(library_state.c.epoch)) if "epoch" in columns else None


def _must_last(url: str) -> None:
    if is_in_memory(url):
        raise ParameterError("a library in memory cannot be moved")


@contextmanager
def _opened(url: str, engine: Engine) -> Iterator[End]:
    path = None if is_shared(url) else sqlite_file(url)
    if path is not None and not path.absolute().parent.is_dir():
        raise ParameterError(f"there is no folder {path.parent}")
    try:
        with _lease(url), engine.connect() as connection:
            if path is None:
                postgres.begin_move(connection)
                _must_be_alone(connection, shown_url(url))
            yield End(engine, connection, path)
    finally:
        engine.dispose()


@contextmanager
def _lease(url: str) -> Iterator[None]:
    """Hold the lease of an SQLite library, so that no server runs its jobs."""
    try:
        lease = Lease(url)
    except StoreInUseError as error:
        raise error.with_advice(_STOP) from None
    with lease:
        yield


def _must_be_alone(connection: Connection, name: str) -> None:
    """Raise StoreInUseError if other sessions use a library in PostgreSQL, such as those of a server."""
    for session, seconds in ((postgres.NAME, _CLOSING_SECONDS), (postgres.MOVING, _ENDING_SECONDS)):
        end = time.monotonic() + seconds
        while others := postgres.other_sessions(connection, session):
            if time.monotonic() > end:
                raise StoreInUseError(f"{counted(others, 'other session')} of unbend use {name}").with_advice(_STOP)
            time.sleep(_LOOK_SECONDS)
