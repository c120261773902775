"""Errors and states of database transactions, for the store and its writer."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

from sqlalchemy import Connection
from sqlalchemy.exc import DatabaseError, IntegrityError, TimeoutError  # noqa: A004

from unbend.errors import StoreError, StoreFullError

_DISK_FULL: Final = frozenset({"SQLITE_FULL", "SQLITE_IOERR_SHMSIZE", "SQLITE_IOERR_SHMMAP"})
"""SQLite's errors of a full disk: of the file and its log, and of the log's index."""


@contextmanager
def as_store_error() -> Iterator[None]:
    """Replace a database's errors by StoreError, whose message hides the paths and statements of its cause."""
    try:
        yield
    except (IntegrityError, sqlite3.IntegrityError):  # a bug of this program, not a failure of the database
        raise
    except (DatabaseError, TimeoutError, sqlite3.Error) as error:
        if getattr(getattr(error, "orig", error), "sqlite_errorname", "") in _DISK_FULL:
            raise StoreFullError("the disk of the library is full") from error
        raise StoreError("the library's store cannot be used") from error


def is_open(connection: Connection) -> bool:
    """Return whether a connection's transaction is still open: SQLite rolls it back when its disk is full."""
    driver: Any = connection.connection.dbapi_connection
    return bool(getattr(driver, "in_transaction", True))
