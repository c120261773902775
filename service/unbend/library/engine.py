"""Opening a store: the connection's settings, transactions, and the migration to today's schema."""

from __future__ import annotations

import asyncio
import sqlite3
import threading
from collections.abc import Callable, Hashable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import Any, TypeVar

from alembic import command
from alembic.config import Config
from alembic.script import ScriptDirectory
from alembic.util import CommandError
from sqlalchemy import URL, Connection, Engine, create_engine, event, make_url
from sqlalchemy.exc import ArgumentError, DatabaseError, IntegrityError, TimeoutError  # noqa: A004

from unbend.errors import ParameterError, StoreError, StoreFullError, StoreVersionError
from unbend.library.erasing import LogEraser, When, take_mark
from unbend.library.memory import Memory
from unbend.library.place import Place

T = TypeVar("T")

_BUSY_SECONDS = 30
_UNUSED = ("freelist_count", "page_size")
_MIGRATIONS = Path(__file__).parent / "migrations"
_FULL = frozenset({"SQLITE_FULL", "SQLITE_IOERR_SHMSIZE", "SQLITE_IOERR_SHMMAP"})
"""SQLite's errors of a full disk: for the file and its log, and for the index of the log."""

_TOOLS = {"postgresql": "pg_dump and pg_restore", "mysql": "mysqldump", "mariadb": "mariadb-dump"}


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
        self._reading = self._engine.execution_options(unbend_reading=True)
        self._is_file = self._engine.dialect.name == "sqlite"
        # SQLite lets writers wait by sleeping longer and longer; those of this process wait in a line instead.
        self._turn: AbstractContextManager[object] = threading.Lock() if self._is_file else nullcontext()
        self._eraser = LogEraser(self._engine) if self._is_file else None
        if self._is_file:
            event.listen(self._engine, "connect", _prepare_sqlite)
            event.listen(self._engine, "begin", _begin_sqlite)
        if migrate:
            _migrate(self._engine)
            self.erase("soon")  # a migration may take words out of the history
        self._memory = Memory(self._engine) if self._is_file else None
        self._place = Place(sqlite_file(url).absolute()) if _is_on_disk(url) else None

    @contextmanager
    def read(self) -> Iterator[Connection]:
        """Yield a connection that sees one unchanging state; StoreError where the database cannot give it."""
        self.check()
        with failing_as_store(), self._reading.connect() as connection:
            yield connection

    @contextmanager
    def write(self) -> Iterator[Connection]:
        """Yield a connection whose changes are kept together, on disk, when the block ends without an error.

        Raises
        ------
        StoreError
            If the database cannot keep them: StoreFullError if its disk is full, StoreLostError if its file is gone.
        """
        self.check()
        with self._turn, failing_as_store(), self._engine.begin() as connection:
            take_mark(connection)  # of a transaction that was undone
            yield connection
            mark = take_mark(connection)
            if not is_open(connection):  # to commit nothing is no error to SQLite
                raise StoreError("the database undid the transaction")
        self.check()  # what was written to a file that is gone is not kept
        if mark:
            self.erase(mark)

    def change(self, change: Callable[[Connection], T]) -> T:
        """Make a change in a transaction of its own; where the disk is full, again with the room kept in reserve.

        Raises
        ------
        StoreError
            As `write` does.
        Exception
            Whatever the change raises.
        """
        try:
            with self.write() as connection:
                return change(connection)
        except StoreFullError as error:
            # What `admit` refuses has no cause, and is no reason to give the reserve up: anybody may be refused.
            if error.__cause__ is None or self._place is None or not self._place.release():
                raise
        with self.write() as connection:
            return change(connection)

    def check(self) -> None:
        """Raise StoreLostError if the library's file was removed or replaced since it was opened."""
        if self._place:
            self._place.check()

    def reserve(self, size: int) -> None:
        """Keep `size` bytes of the disk for changes that make room, such as removals."""
        if self._place:
            self._place.reserve(size)

    def admit(self, size: int) -> None:
        """Raise StoreFullError if there is no room for an upload of `size` bytes; needs `reserve`."""
        if self._place:
            self._place.admit(size, self._unused())

    def admit_result(self) -> None:
        """Raise StoreFullError if there is no room for the result of a job; there is where uploads are admitted."""
        if self._place:
            self._place.admit(None, self._unused())

    def free(self) -> int | None:
        """Return the free bytes of the library's disk; None where it is not a file."""
        return self._place.free() if self._place else None

    def _unused(self) -> int:
        with self.read() as connection:
            pages, size = (connection.exec_driver_sql(f"PRAGMA {name}").scalar_one() for name in _UNUSED)
        return int(pages) * int(size)

    async def fetch(self, look: Callable[[Connection], T], question: Hashable = None) -> T:
        """Return what `look`, a matter of a few rows, finds, without holding up the event loop.

        From a file that is done at once: it takes less than going to a thread and back, and no writer is waited for.

        Parameters
        ----------
        look : callable
        question : hashable, optional
            A name for what is looked for. Where it was found before, and nothing was written since, it is not looked
            for again.
        """
        if self._memory is None:
            return await asyncio.to_thread(self._look, look)
        if question is None:
            return self._look(look)
        self.check()
        with failing_as_store():
            return self._memory.recall(question, lambda: self._look(look))

    def _look(self, look: Callable[[Connection], T]) -> T:
        with self.read() as connection:
            return look(connection)

    @contextmanager
    def driver_connection(self) -> Iterator[Any]:
        """Yield a connection as the database's driver has it, outside any transaction."""
        raw = self._engine.raw_connection()
        try:
            yield raw.driver_connection
        finally:
            raw.close()

    def erase(self, when: When = "now") -> None:
        """Empty SQLite's write-ahead log, so that nothing deleted is found there; soon, if a reader is in the way."""
        if self._eraser is not None:
            self._eraser.erase(when)

    def close(self) -> None:
        """Close all connections."""
        if self._eraser:
            self._eraser.close()
        if self._memory:
            self._memory.close()
        self._engine.dispose()
        if self._place:
            self._place.close()


def sqlite_file(url: str) -> Path:
    """Return the file of a library, which need not be there.

    Raises
    ------
    ParameterError
        If it is in another database than SQLite; the message names that one's own tool.
    """
    address = _address(url)
    kind = address.get_backend_name()
    if kind != "sqlite":
        raise ParameterError(f"the library is no SQLite file but in {kind}: use {_TOOLS.get(kind, 'its own tool')}")
    if address.database in {None, "", ":memory:"}:
        raise ParameterError("the library is in memory, not in a file")
    return Path(str(address.database))


def must_be_there(url: str) -> None:
    """Raise ParameterError where a library is an SQLite file that is not there: opening it would make an empty one."""
    address = _address(url)
    if address.get_backend_name() == "sqlite" and address.database and not Path(address.database).is_file():
        raise ParameterError(f"there is no library at {address.database}")


def make_schema(path: Path, revision: str) -> None:
    """Make an empty library of an earlier, or today's, schema in a file that is empty or not there."""
    engine = create_engine(URL.create("sqlite", database=str(path)))
    event.listen(engine, "begin", _begin_sqlite)
    event.listen(engine, "connect", _without_driver)
    try:
        _migrate(engine, revision)
    finally:
        engine.dispose()


def revisions() -> frozenset[str]:
    """Return the revisions of the schema that this version knows."""
    return frozenset(script.revision for script in ScriptDirectory.from_config(_config()).walk_revisions())


@contextmanager
def failing_as_store() -> Iterator[None]:
    """Turn what a database reports into StoreError, which says no more: the cause has paths and statements."""
    try:
        yield
    except (IntegrityError, sqlite3.IntegrityError):  # not the database's fault but ours
        raise
    except (DatabaseError, TimeoutError, sqlite3.Error) as error:
        if getattr(getattr(error, "orig", error), "sqlite_errorname", "") in _FULL:
            raise StoreFullError("the disk of the library is full") from error
        raise StoreError("the library's store cannot be used") from error


def is_open(connection: Connection) -> bool:
    """Return whether a connection's transaction still stands: SQLite undoes it where its disk is full."""
    driver: Any = connection.connection.dbapi_connection
    return bool(getattr(driver, "in_transaction", True))


def _is_on_disk(url: str) -> bool:
    address = _address(url)
    return address.get_backend_name() == "sqlite" and address.database not in {None, "", ":memory:"}


def _create_engine(url: str) -> Engine:
    try:
        if _is_on_disk(url):
            return create_engine(_address(url), max_overflow=-1)  # a thread that needs a connection gets one
        return create_engine(_address(url))
    except (ArgumentError, ImportError):  # the driver of a database that is not installed
        raise _unknown(url) from None


def _address(url: str) -> URL:
    if "://" not in url:
        try:
            return URL.create("sqlite", database=str(Path(url).expanduser()))
        except RuntimeError:  # the home of a user who does not exist
            raise ParameterError(f"{url}: there is no such user") from None
    try:
        return make_url(url)
    except (ArgumentError, ValueError):  # a port that is no number
        raise _unknown(url) from None


def _unknown(url: str) -> ParameterError:
    return ParameterError(f"{url.split(':', maxsplit=1)[0]}: not a path, or not the URL of a database that we know")


def _without_driver(connection: Any, _record: object) -> None:
    connection.isolation_level = None  # transactions are begun below, not by the driver


def _prepare_sqlite(connection: Any, record: object) -> None:
    _without_driver(connection, record)
    cursor = connection.cursor()
    cursor.execute(f"PRAGMA busy_timeout = {_BUSY_SECONDS * 1000}")
    cursor.execute("PRAGMA journal_mode = WAL")
    cursor.execute("PRAGMA synchronous = FULL")  # what was acknowledged survives a power cut
    cursor.execute("PRAGMA secure_delete = ON")  # what was deleted is overwritten
    cursor.close()


def _begin_sqlite(connection: Connection) -> None:
    options = connection.get_execution_options()
    # The driver's own connection: SQLAlchemy's way to a cursor costs more than a small transaction.
    driver: Any = connection.connection.dbapi_connection
    # A migration makes tables anew, and with the old one everything that refers to it would go.
    driver.execute(f"PRAGMA foreign_keys = {'OFF' if options.get('unbend_migrating') else 'ON'}")
    # A writer takes its lock at once: one that reads first and writes later can be refused half way.
    driver.execute("BEGIN" if options.get("unbend_reading") else "BEGIN IMMEDIATE")


def _config() -> Config:
    config = Config()
    config.set_main_option("script_location", str(_MIGRATIONS).replace("%", "%%"))
    config.set_main_option("path_separator", "os")
    return config


def _migrate(engine: Engine, revision: str = "head") -> None:
    config = _config()
    try:
        with engine.execution_options(unbend_migrating=True).begin() as connection:
            config.attributes["connection"] = connection
            command.upgrade(config, revision)
    except CommandError as error:
        raise StoreVersionError("the library was made by a later version of unbend") from error
    except (DatabaseError, sqlite3.Error) as error:  # the latter from the beginning of a transaction
        place, why = engine.url.render_as_string(hide_password=True), getattr(error, "orig", error)
        raise StoreError(f"the library at {place} cannot be opened: {why}") from error
