"""Opening a store: the connection's settings, transactions, and the migration to today's schema."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from alembic import command
from alembic.config import Config
from alembic.util import CommandError
from sqlalchemy import URL, Connection, Engine, create_engine, event
from sqlalchemy.exc import ArgumentError, DatabaseError, IntegrityError, TimeoutError  # noqa: A004

from unbend.errors import ParameterError, StoreError, StoreVersionError

_BUSY_SECONDS = 30
_MIGRATIONS = Path(__file__).parent / "migrations"


class Store:
    """An open database; thread-safe.

    Parameters
    ----------
    url : str
        A path of an SQLite file, or an SQLAlchemy URL.
    migrate : bool, default True
        Bring the schema up to date first. Worker processes leave that to the process that started them.

    Raises
    ------
    StoreVersionError
        If the store was made by a later version.
    StoreError
        If it cannot be opened.
    """

    def __init__(self, url: str, *, migrate: bool = True) -> None:
        self.url = url
        self._engine = _create_engine(url)
        if self._engine.dialect.name == "sqlite":
            event.listen(self._engine, "connect", _prepare_sqlite)
            event.listen(self._engine, "begin", _begin_sqlite)
        if migrate:
            _migrate(self._engine)

    @contextmanager
    def read(self) -> Iterator[Connection]:
        """Yield a connection that sees one unchanging state; StoreError where the database cannot give it."""
        with _failing_as_store(), self._engine.connect() as connection:
            yield connection.execution_options(unbend_reading=True)

    @contextmanager
    def write(self) -> Iterator[Connection]:
        """Yield a connection whose changes are kept together, on disk, when the block ends without an error.

        Raises
        ------
        StoreError
            If the database cannot keep them.
        """
        with _failing_as_store(), self._engine.begin() as connection:
            yield connection

    def close(self) -> None:
        """Close all connections."""
        self._engine.dispose()


@contextmanager
def _failing_as_store() -> Iterator[None]:
    """Turn what a database reports into an error of our tree. It says no more: the cause has paths and statements."""
    try:
        yield
    except IntegrityError:  # not the database's fault but ours
        raise
    except (DatabaseError, TimeoutError) as error:
        raise StoreError("the library's store cannot be used") from error


def _create_engine(url: str) -> Engine:
    try:
        if "://" not in url:
            return create_engine(URL.create("sqlite", database=str(Path(url).expanduser())))
        return create_engine(url)
    except (ArgumentError, ImportError):  # the driver of a database that is not installed
        raise ParameterError(
            f"{url.split(':', maxsplit=1)[0]}: not a path, or not the URL of a database that we know"
        ) from None


def _prepare_sqlite(connection: Any, _record: object) -> None:
    connection.isolation_level = None  # transactions are begun below, not by the driver
    cursor = connection.cursor()
    cursor.execute(f"PRAGMA busy_timeout = {_BUSY_SECONDS * 1000}")
    cursor.execute("PRAGMA journal_mode = WAL")
    cursor.execute("PRAGMA synchronous = FULL")  # what was acknowledged survives a power cut
    cursor.close()


def _begin_sqlite(connection: Connection) -> None:
    options = connection.get_execution_options()
    # A migration makes tables anew, and with the old one everything that refers to it would go.
    connection.exec_driver_sql(f"PRAGMA foreign_keys = {'OFF' if options.get('unbend_migrating') else 'ON'}")
    # A writer takes its lock at once: one that reads first and writes later can be refused half way.
    connection.exec_driver_sql("BEGIN" if options.get("unbend_reading") else "BEGIN IMMEDIATE")


def _migrate(engine: Engine) -> None:
    config = Config()
    config.set_main_option("script_location", str(_MIGRATIONS).replace("%", "%%"))
    config.set_main_option("path_separator", "os")
    try:
        with engine.execution_options(unbend_migrating=True).begin() as connection:
            config.attributes["connection"] = connection
            command.upgrade(config, "head")
    except CommandError as error:
        raise StoreVersionError("the library was made by a later version of unbend") from error
    except DatabaseError as error:
        raise StoreError(
            f"the library at {engine.url.render_as_string(hide_password=True)} cannot be opened: {error.orig}"
        ) from error
