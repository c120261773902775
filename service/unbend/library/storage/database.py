"""Databases of libraries: URLs, the settings of connections, and migrations to the present schema."""

from __future__ import annotations

import sqlite3
from pathlib import Path
from typing import Any, Final

from alembic import command
from alembic.config import Config
from alembic.script import ScriptDirectory
from alembic.util import CommandError
from sqlalchemy import URL, Connection, Engine, create_engine, event, make_url
from sqlalchemy.exc import ArgumentError, DatabaseError

from unbend.errors import ParameterError, StoreError, StoreVersionError

_BUSY_SECONDS: Final = 30
_MIGRATIONS: Final = Path(__file__).parent.parent / "migrations"
_TOOLS: Final = {"postgresql": "pg_dump and pg_restore", "mysql": "mysqldump", "mariadb": "mariadb-dump"}


def sqlite_file(url: str) -> Path:
    """Return the path of a library's file; the file need not exist.

    Raises
    ------
    ParameterError
        If the library is not an SQLite file; the message names the tool of its database.
    """
    address = _address(url)
    kind = address.get_backend_name()
    if kind != "sqlite":
        raise ParameterError(f"the library is in {kind}, not in an SQLite file: use {_TOOLS.get(kind, 'its own tool')}")
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
    engine = create_engine(URL.create("sqlite", database=str(path)))
    event.listen(engine, "begin", _begin_sqlite)
    event.listen(engine, "connect", _disable_driver_transactions)
    try:
        migrate_engine(engine, revision)
    finally:
        engine.dispose()


def revisions() -> frozenset[str]:
    """Return the revisions of the schema that this version knows."""
    return frozenset(script.revision for script in ScriptDirectory.from_config(_config()).walk_revisions())


def is_in_memory(url: str) -> bool:
    """Return whether a library is an SQLite database without a file."""
    address = _address(url)
    return address.get_backend_name() == "sqlite" and address.database in {None, "", ":memory:"}


def open_engine(url: str) -> Engine:
    """Return an engine for a library, with this program's settings; ParameterError for an unknown database."""
    address = _address(url)
    is_file = address.get_backend_name() == "sqlite" and not is_in_memory(url)
    try:
        # No limit on connections: every thread that needs a connection to a file gets one.
        engine = create_engine(address, max_overflow=-1) if is_file else create_engine(address)
    except (ArgumentError, ImportError):  # ImportError: the driver of the database is not installed
        raise _unknown(url) from None
    if engine.dialect.name == "sqlite":
        event.listen(engine, "connect", _prepare_sqlite)
        event.listen(engine, "begin", _begin_sqlite)
    return engine


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
        return make_url(url)
    except (ArgumentError, ValueError):  # for example a port that is not a number
        raise _unknown(url) from None


def _unknown(url: str) -> ParameterError:
    return ParameterError(f"{url.split(':', maxsplit=1)[0]}: neither a path nor the URL of a known database")


def _disable_driver_transactions(connection: Any, _record: object) -> None:
    connection.isolation_level = None  # `_begin_sqlite` begins transactions, not the driver


def _prepare_sqlite(connection: Any, record: object) -> None:
    _disable_driver_transactions(connection, record)
    cursor = connection.cursor()
    cursor.execute(f"PRAGMA busy_timeout = {_BUSY_SECONDS * 1000}")
    cursor.execute("PRAGMA journal_mode = WAL")
    cursor.execute("PRAGMA synchronous = FULL")  # acknowledged changes survive a power failure
    cursor.execute("PRAGMA secure_delete = ON")  # SQLite overwrites deleted content
    cursor.close()


def _begin_sqlite(connection: Connection) -> None:
    options = connection.get_execution_options()
    # Use the driver's connection: SQLAlchemy's path to a cursor costs more than a small transaction.
    driver: Any = connection.connection.dbapi_connection
    # A migration replaces tables: with foreign keys, dropping the old table would delete every row that refers to it.
    driver.execute(f"PRAGMA foreign_keys = {'OFF' if options.get('unbend_migrating') else 'ON'}")
    # A writer locks at once: SQLite can refuse a transaction that reads first and writes later.
    driver.execute("BEGIN" if options.get("unbend_reading") else "BEGIN IMMEDIATE")


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
    StoreError
        If the database cannot be opened.
    """
    config = _config()
    try:
        with engine.execution_options(unbend_migrating=True).begin() as connection:
            config.attributes["connection"] = connection
            command.upgrade(config, revision)
    except CommandError as error:
        raise StoreVersionError("the library was made by a later version of unbend") from error
    except (DatabaseError, sqlite3.Error) as error:  # sqlite3.Error: from `_begin_sqlite`
        place, why = engine.url.render_as_string(hide_password=True), getattr(error, "orig", error)
        raise StoreError(f"the library at {place} cannot be opened: {why}") from error
