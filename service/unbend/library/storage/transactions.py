"""Errors and states of database transactions, for the store and its writer."""

from __future__ import annotations

import random
import sqlite3
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Final, TypeVar

from sqlalchemy import Connection
from sqlalchemy.exc import DBAPIError, IntegrityError, TimeoutError  # noqa: A004

from unbend.errors import StoreError, StoreFullError, StoreUnavailableError
from unbend.library.storage.postgres import is_disk_full, is_transient

T = TypeVar("T")

_DISK_FULL: Final = frozenset({"SQLITE_FULL", "SQLITE_IOERR_SHMSIZE", "SQLITE_IOERR_SHMMAP"})
"""SQLite's errors of a full disk: of the file and its log, and of the log's index."""

_FIRST_PAUSE: Final = 0.02
"""Seconds before the second attempt at a transaction, on average; each further pause is twice as long."""

_RETRY_SECONDS: Final = 2.0
"""Time after which no further attempt begins, because a client waits."""


@contextmanager
def as_store_error() -> Iterator[None]:
    """Replace a database's errors by StoreError, whose message hides the paths and statements of its cause."""
    try:
        yield
    except (IntegrityError, sqlite3.IntegrityError):  # a bug of this program, not a failure of the database
        raise
    except (DBAPIError, TimeoutError, sqlite3.Error) as error:
        if getattr(getattr(error, "orig", error), "sqlite_errorname", "") in _DISK_FULL or is_disk_full(error):
            raise StoreFullError("the disk of the library is full") from error
        if is_transient(error):
            raise StoreUnavailableError("the library's database does not answer") from error
        raise StoreError("the library's store cannot be used") from error


def retried(transaction: Callable[[], T]) -> T:
    """Run a transaction, and run it again while another one, or a restart of PostgreSQL, stands in its way.

    A lost connection may hide that the transaction was committed. So it must do no harm if it runs twice.
    """
    pause, deadline = _FIRST_PAUSE, time.monotonic() + _RETRY_SECONDS
    while True:
        try:
            return transaction()
        except (StoreUnavailableError, IntegrityError) as error:
            passes = not isinstance(error, IntegrityError) or is_transient(error)
            if not passes or time.monotonic() + pause > deadline:
                raise
        time.sleep(pause * random.uniform(0.5, 1.5))  # noqa: S311  so that two transactions do not meet again
        pause *= 2


def is_open(connection: Connection) -> bool:
    """Return whether a connection's transaction is still open: SQLite rolls it back when its disk is full."""
    driver: Any = connection.connection.dbapi_connection
    return bool(getattr(driver, "in_transaction", True))
