"""The store: one database, its connections, transactions and caches."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Hashable, Iterator, Mapping
from concurrent.futures import Future
from contextlib import contextmanager
from functools import partial
from typing import Any, TypeVar

from sqlalchemy import Connection, Engine

from unbend.errors import ParameterError, StoreError, StoreFullError
from unbend.library.storage import postgres
from unbend.library.storage.database import is_in_memory, migrate_engine, open_engine, sqlite_file
from unbend.library.storage.disk import LibraryDisk
from unbend.library.storage.log_eraser import LogEraser, Urgency, take_mark
from unbend.library.storage.object_deletions import ObjectDeletions
from unbend.library.storage.object_rows import take_dropped
from unbend.library.storage.objects import Objects
from unbend.library.storage.read_cache import ReadCache
from unbend.library.storage.transactions import as_store_error, is_open, retried
from unbend.library.storage.writer import ConcurrentWriter, Writer

T = TypeVar("T")

_UNUSED_PRAGMAS = ("freelist_count", "page_size")


class Store:
    """An open database; thread-safe.

    Parameters
    ----------
    url : str
        A path of an SQLite file, or an SQLAlchemy URL.
    migrate : bool, default True
        Migrate the database to the present schema first. Worker processes leave the migration to their parent.
    objects : str, optional
        The address of an object store, where the files of new meshes are then kept (see `Objects`).

    Raises
    ------
    StoreVersionError
        If a later version of unbend made the store.
    StoreError
        If the store cannot be opened.
    ParameterError
        If `objects` is no address of an object store, or the database is in memory.
    """

    def __init__(self, url: str, *, migrate: bool = True, objects: str | None = None) -> None:
        self.url = url
        if objects and is_in_memory(url):
            raise ParameterError("a library in memory keeps its meshes in memory, too", field="objects")
        self.objects = Objects(objects) if objects else None
        self.deletions = ObjectDeletions(self, self.objects) if self.objects else None
        self._engine = open_engine(url)
        self._is_sqlite = is_sqlite = self._engine.dialect.name == "sqlite"
        self._reading = (
            self._engine.execution_options(unbend_reading=True) if is_sqlite else postgres.one_state(self._engine)
        )
        self._of_one_statement = self._engine if is_sqlite else postgres.one_statement(self._engine)
        self._is_in_memory = is_in_memory(url)
        self._eraser = LogEraser(self._engine) if is_sqlite else None
        if migrate:
            self._migrate()
            self.erase("soon")  # a migration may delete content from the history of jobs
        has_file = is_sqlite and not self._is_in_memory
        self._cache = ReadCache(self._engine) if has_file else None
        self.disk = LibraryDisk(sqlite_file(url).absolute(), self._unused_bytes) if has_file else None
        self._writer: Writer | ConcurrentWriter | None = None
        self._writer_lock = threading.Lock()
        self._is_closed = False

    def _migrate(self) -> None:
        try:
            migrate_engine(self._engine)
        except BaseException:
            self._engine.dispose()  # nobody else can close its connections
            raise

    @property
    def is_closed(self) -> bool:
        """Whether the store was closed."""
        return self._is_closed

    @property
    def engine(self) -> Engine:
        """The engine of the database, for long work outside the writer, such as the build of an index."""
        return self._engine

    @property
    def postgres(self) -> Mapping[str, Any] | None:
        """The arguments with which psycopg connects to the database; None for SQLite."""
        return None if self._is_sqlite else postgres.connection_arguments(self._engine)

    @contextmanager
    def read(self) -> Iterator[Connection]:
        """Yield a connection that sees one unchanging state; StoreError if the database fails."""
        self.check()
        with as_store_error(), self._reading.connect() as connection:
            yield connection

    def submit(self, change: Callable[[Connection], T], *, is_statement: bool = False) -> Future[T]:
        """Queue a change for the writer; the change is on disk when the future has its result.

        A change may run several times (see `Writer` and `retried`). If the database is in memory, the change runs in
        the caller's thread.

        Parameters
        ----------
        change : callable
        is_statement : bool, default False
            Whether the change writes by one statement only. PostgreSQL then commits it by itself, without two more
            round trips.

        Raises
        ------
        StoreError
            From the future, if the database cannot store the change: StoreFullError if its disk is full, StoreLostError
            if its file was removed or replaced.
        Exception
            From the future, whatever the change raises.
        """
        if self._is_in_memory:  # an in-memory database belongs to one thread
            return _completed(partial(_Transactions(self).single, change))
        with self._writer_lock:
            if self._is_closed:
                raise StoreError("the library is closed")
            if self._writer is None:
                transactions = _Transactions(self)
                self._writer = Writer(transactions) if self._is_sqlite else ConcurrentWriter(transactions)
            return self._writer.submit(change, is_statement=is_statement)

    def change(self, change: Callable[[Connection], T]) -> T:
        """Run a change, and wait until its result is on disk; raises as the future of `submit` does."""
        return self.submit(change).result()

    def check(self) -> None:
        """Raise StoreLostError if the library's file was removed or replaced since it was opened.

        A closed store raises StoreError.
        """
        if self._is_closed:
            raise StoreError("the library is closed")
        if self.disk:
            self.disk.check()

    async def fetch(self, load: Callable[[Connection], T], cache_key: Hashable = None) -> T:
        """Return the few rows that `load` reads, without blocking the event loop.

        A read from SQLite runs in place: it takes less time than a switch to a thread, and waits for no writer.

        Parameters
        ----------
        load : callable
        cache_key : hashable, optional
            A key under which the result is cached until somebody writes to the store. Only reads from files are cached.
        """
        if not self._is_sqlite:
            return await asyncio.to_thread(self.load, load)
        if self._cache is None or cache_key is None:
            return self.load(load)
        self.check()
        with as_store_error():
            return self._cache.get_or_load(cache_key, lambda: self.load(load))

    def load(self, load: Callable[[Connection], T]) -> T:
        """Return what `load` reads in a transaction of its own; `load` runs again if the database was interrupted."""

        def read() -> T:
            with self.read() as connection:
                return load(connection)

        return retried(read)

    @contextmanager
    def driver_connection(self) -> Iterator[Any]:
        """Yield a connection of the database's driver, outside any transaction."""
        raw = self._engine.raw_connection()
        try:
            yield raw.driver_connection
        finally:
            raw.close()

    def erase(self, urgency: Urgency = "now") -> None:
        """Truncate SQLite's write-ahead log, which may contain deleted content (see `LogEraser.erase`)."""
        if self._eraser is not None:
            self._eraser.erase(urgency)

    def close(self) -> None:
        """Run the queued changes and the queued deletions of objects, and close all connections."""
        if self.deletions:
            self.deletions.close()
        with self._writer_lock:
            if self._writer:
                self._writer.close()
            self._is_closed = True
        if self._eraser:
            self._eraser.close()
        if self._cache:
            self._cache.close()
        self._engine.dispose()
        if self.disk:
            self.disk.close()

    def _unused_bytes(self) -> int:
        with self.read() as connection:
            pages, size = (connection.exec_driver_sql(f"PRAGMA {name}").scalar_one() for name in _UNUSED_PRAGMAS)
        return int(pages) * int(size)

    @contextmanager
    def write(self, *, is_statement: bool = False) -> Iterator[Connection]:
        """Yield a connection whose changes are committed together when the block ends without an error.

        Only the transactions of `submit` use this; all other code calls `change` or `submit`.
        """
        self.check()
        engine = self._of_one_statement if is_statement else self._engine
        with as_store_error(), engine.begin() as connection:
            take_mark(connection)  # discard the marks of an earlier transaction that was rolled back
            take_dropped(connection)
            yield connection
            mark, dropped = take_mark(connection), take_dropped(connection)
            if not is_open(connection):  # SQLite reports no error for a commit of nothing
                raise StoreError("the database rolled back the transaction")
        self.check()  # a commit to a removed file is lost
        if mark:
            self.erase(mark)
        if dropped and self.deletions:
            self.deletions.wake()


class _Transactions:
    """The write transactions of a store, for its writer, or for `Store.submit` if the database is in memory."""

    def __init__(self, store: Store) -> None:
        self._store = store

    def batch(self, change: Callable[[Connection], T], *, is_statement: bool = False) -> T:
        with self._store.write(is_statement=is_statement) as connection:
            return change(connection)

    def single(self, change: Callable[[Connection], T], *, is_statement: bool = False) -> T:
        try:
            return retried(partial(self.batch, change, is_statement=is_statement))
        except StoreFullError as error:
            # `LibraryDisk.admit_upload` refuses with an error that has no cause. A refusal must not use up the reserve.
            if error.__cause__ is None or self._store.disk is None or not self._store.disk.release():
                raise
        return self.batch(change)


def _completed(function: Callable[[], T]) -> Future[T]:
    future: Future[T] = Future()
    try:
        future.set_result(function())
    except Exception as error:  # noqa: BLE001  the caller gets it from the future
        future.set_exception(error)
    return future
