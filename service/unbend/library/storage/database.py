"""Databases of libraries: URLs, the settings of connections, and migrations to the present schema."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Final

from alembic import command
from alembic.config import Config
from alembic.script import ScriptDirectory
from alembic.util import CommandError
from sqlalchemy import URL, Engine, create_engine, make_url
from sqlalchemy.exc import ArgumentError, DBAPIError

from unbend.errors import ParameterError, StoreError, StoreVersionError
from unbend.library.storage import postgres, queue_schema, sqlite, unfinished

_DATABASES: Final = ("sqlite", "postgresql", "postgres")
_MIGRATIONS: Final = Path(__file__).parent.parent / "migrations"


def sqlite_file(url: str) -> Path:
    """Return the path of a library's file; the file need not exist.

    Raises
    ------
    ParameterError
        If the library is not an SQLite file; the message names the tool of its database.
    """
    address = _address(url)
    if address.get_backend_name() != "sqlite":
        raise ParameterError("the library is in PostgreSQL, not in an SQLite file: use pg_dump and pg_restore")
    if address.database in {None, "", ":memory:"}:
        raise ParameterError("the library is in memory, not in a file")
    return Path(str(address.database))


def must_exist(url: str) -> None:
    """Raise ParameterError if the file of an SQLite library is missing: opening it would create an empty library."""
    address = _address(url)
    if address.get_backend_name() == "sqlite" and address.database and not Path(address.database).is_file():
        raise ParameterError(f"there is no library at {address.database}")


def create_schema(path: Path, revision: str) -> None:
    """Create an empty library of an earlier or the present schema, in a file that is empty or missing."""
    engine = sqlite.with_own_transactions(create_engine(URL.create("sqlite", database=str(path))))
    try:
        migrate_engine(engine, revision)
    finally:
        engine.dispose()


@cache
def revisions() -> frozenset[str]:
    """Return the revisions of the schema that this version knows."""
    return frozenset(script.revision for script in ScriptDirectory.from_config(_config()).walk_revisions())


def latest_revision() -> str:
    """Return the revision of this version's schema."""
    return max(revisions())


def is_in_memory(url: str) -> bool:
    """Return whether a library is an SQLite database without a file."""
    address = _address(url)
    return address.get_backend_name() == "sqlite" and address.database in {None, "", ":memory:"}


def is_shared(url: str) -> bool:
    """Return whether several servers and workers can share a library: it is in PostgreSQL."""
    return _address(url).get_backend_name() != "sqlite"


def open_engine(url: str) -> Engine:
    """Return an engine for a library, with this program's settings.

    Raises
    ------
    ParameterError
        If the URL is of an unknown database.
    ExtraMissingError
        If the driver of PostgreSQL is not installed.
    """
    address = _address(url)
    if address.get_backend_name() != "sqlite":
        return postgres.open_postgres(address)
    try:
        # No limit on connections: every thread that needs a connection to a file gets one.
        engine = create_engine(address) if is_in_memory(url) else create_engine(address, max_overflow=-1)
    except (ArgumentError, ImportError):  # another driver
        raise _unknown(url) from None
    return sqlite.prepare(engine)


def open_reading_engine(url: str) -> Engine:
    """Return an engine that only reads: of an SQLite file, it changes not even the header.

    Raises
    ------
    ParameterError
        If the URL is of an unknown database, or there is no such SQLite file.
    """
    must_exist(url)
    address = _address(url)
    if address.get_backend_name() != "sqlite":
        return postgres.one_state(postgres.open_postgres(address))
    try:
        engine = sqlite.with_own_transactions(create_engine(address))
    except (ArgumentError, ImportError):  # another driver
        raise _unknown(url) from None
    return engine.execution_options(unbend_reading=True)


def shown_url(url: str) -> str:
    """Return a library's address as others may see it: without a password."""
    return _address(url).render_as_string(hide_password=True) if "://" in url else url


def _address(url: str) -> URL:
    if "://" not in url:
        try:
            return URL.create("sqlite", database=str(Path(url).expanduser()))
        except RuntimeError:  # the home folder of an unknown user
            raise ParameterError(f"{url}: there is no such user") from None
    try:
        address = make_url(url)
        known = address.get_backend_name() in _DATABASES
    except (ArgumentError, ValueError):  # for example a port that is not a number
        raise _unknown(url) from None
    if not known:
        raise _unknown(url)
    return address


def _unknown(url: str) -> ParameterError:
    return ParameterError(f"{url.split(':', maxsplit=1)[0]}: neither a path nor the URL of a known database")


def _config() -> Config:
    config = Config()
    config.set_main_option("script_location", str(_MIGRATIONS).replace("%", "%%"))
    config.set_main_option("path_separator", "os")
    return config


def migrate_engine(engine: Engine, revision: str = "head") -> None:
    """Migrate a database to a revision of the schema.

    Raises
    ------
    StoreVersionError
        If a later version of unbend made the database.
    StoreUnfinishedError
        If it is the target of a move that was interrupted.
    StoreError
        If the database cannot be opened.
    """
    config = _config()
    with opening(engine.url), engine.execution_options(unbend_migrating=True).begin() as connection:
        if connection.dialect.name == "postgresql":
            postgres.begin_migration(connection)
        unfinished.refuse(connection)
        config.attributes["connection"] = connection
        command.upgrade(config, revision)
        if connection.dialect.name == "postgresql":
            queue_schema.upgrade(connection)


@contextmanager
def opening(address: URL) -> Iterator[None]:
    """Replace the errors of a database that is being opened: StoreVersionError, or StoreError, which names it."""
    try:
        yield
    except CommandError as error:
        raise StoreVersionError("the library was made by a later version of unbend") from error
    except (DBAPIError, sqlite3.Error) as error:  # sqlite3.Error: from `sqlite`
        place, why = address.render_as_string(hide_password=True), getattr(error, "orig", error)
        said = " ".join(str(why).split())  # PostgreSQL may say several lines
        raise StoreError(f"the library at {place} cannot be opened: {said}") from error
