"""Erasing: what was deleted leaves SQLite's write-ahead log too.

With `secure_delete`, SQLite overwrites deleted content with zeros. The log beside the file still holds the pages as
they were, until it is written into the file and cut to nothing; that cannot be while somebody reads an earlier state.
"""

from __future__ import annotations

import contextlib
import threading
from typing import Any, Final, Literal

from sqlalchemy import Connection, Engine
from sqlalchemy.exc import SQLAlchemyError

_MARK: Final = "unbend_erased"
_WAIT_MS: Final = 100
"""That writers may be held up while readers are waited for."""
_RETRY_SECONDS: Final = 1.0


When = Literal["now", "soon"]
"""Whether somebody who asked for a deletion waits for it, or it is one among many of the service's own."""


def mark_erased(connection: Connection, when: When) -> None:
    """Note that this transaction deletes what must not be found again."""
    if connection.info.get(_MARK) != "now":
        connection.info[_MARK] = when


def take_mark(connection: Connection) -> When | None:
    """Return the mark of a transaction on this connection, if it has one, and forget it."""
    mark: When | None = connection.info.pop(_MARK, None)
    return mark


class LogEraser:
    """Empties the write-ahead log of an SQLite database, trying each second while a reader is in the way."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._lock = threading.Lock()
        self._timer: threading.Timer | None = None
        self._closed = False

    def erase(self, when: When) -> None:
        """Empty the log now, if no reader is in the way, or soon: once for all that is deleted until then."""
        with self._lock:
            if self._closed or (when == "now" and self._emptied()) or self._timer is not None:
                return
            self._try_later()

    def close(self) -> None:
        """Stop trying; the last connection that is closed empties the log in any case."""
        with self._lock:
            self._closed = True
            if self._timer is not None:
                self._timer.cancel()

    def _try_later(self) -> None:
        self._timer = threading.Timer(_RETRY_SECONDS, self._try_again)
        self._timer.daemon = True
        self._timer.start()

    def _try_again(self) -> None:
        with self._lock:
            self._timer = None
            if not self._closed and not self._emptied():
                self._try_later()

    def _emptied(self) -> bool:
        with contextlib.suppress(SQLAlchemyError, self._engine.dialect.loaded_dbapi.Error):
            raw = self._engine.raw_connection()
            try:
                return _emptied(raw.cursor())
            finally:
                raw.close()
        return False


def _emptied(cursor: Any) -> bool:
    ((patience,),) = cursor.execute("PRAGMA busy_timeout").fetchall()
    cursor.execute(f"PRAGMA busy_timeout = {_WAIT_MS}")
    try:
        ((busy, *_),) = cursor.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
    finally:
        cursor.execute(f"PRAGMA busy_timeout = {patience}")
    return not busy
