"""The eraser of SQLite's write-ahead log, which may contain deleted content.

With `secure_delete`, SQLite overwrites deleted content with zeros. The log beside the file still has the old pages
until a checkpoint truncates the log. A reader of an earlier state blocks that checkpoint.
"""

from __future__ import annotations

import contextlib
import threading
from typing import Any, Final, Literal

from sqlalchemy import Connection, Engine
from sqlalchemy.exc import SQLAlchemyError

_MARK: Final = "unbend_erased"
_WAIT_MS: Final = 100
"""Longest time that a checkpoint may block writers while it waits for readers."""
_RETRY_SECONDS: Final = 1.0


Urgency = Literal["now", "soon"]
"""The time of an erasure: "now" if the caller waits for it, "soon" if a second later is early enough."""


def mark_erased(connection: Connection, urgency: Urgency) -> None:
    """Mark the transaction as one that deletes content, which must also disappear from the log."""
    if connection.info.get(_MARK) != "now":
        connection.info[_MARK] = urgency


def take_mark(connection: Connection) -> Urgency | None:
    """Return and clear the mark of the transaction on this connection."""
    mark: Urgency | None = connection.info.pop(_MARK, None)
    return mark


class LogEraser:
    """Truncates the write-ahead log of an SQLite database, and retries every second while a reader blocks it."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._lock = threading.Lock()
        self._timer: threading.Timer | None = None
        self._closed = False

    def erase(self, urgency: Urgency) -> None:
        """Truncate the log: at once if `urgency` is "now" and no reader blocks it, otherwise a second later.

        While a later attempt is scheduled, further calls do not schedule another.
        """
        with self._lock:
            if self._closed or (urgency == "now" and self._truncated()) or self._timer is not None:
                return
            self._retry_later()

    def close(self) -> None:
        """Stop retrying. SQLite deletes the log when the last connection closes."""
        with self._lock:
            self._closed = True
            if self._timer is not None:
                self._timer.cancel()

    def _retry_later(self) -> None:
        self._timer = threading.Timer(_RETRY_SECONDS, self._retry)
        self._timer.daemon = True
        self._timer.start()

    def _retry(self) -> None:
        with self._lock:
            self._timer = None
            if not self._closed and not self._truncated():
                self._retry_later()

    def _truncated(self) -> bool:
        with contextlib.suppress(SQLAlchemyError, self._engine.dialect.loaded_dbapi.Error):
            raw = self._engine.raw_connection()
            try:
                return _truncate(raw.cursor())
            finally:
                raw.close()
        return False


def _truncate(cursor: Any) -> bool:
    ((timeout,),) = cursor.execute("PRAGMA busy_timeout").fetchall()
    cursor.execute(f"PRAGMA busy_timeout = {_WAIT_MS}")
    try:
        ((busy, *_),) = cursor.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
    finally:
        cursor.execute(f"PRAGMA busy_timeout = {timeout}")
    return not busy
