"""The first file of each key, on disk."""

from __future__ import annotations

import os
import sqlite3
from pathlib import Path
from types import TracebackType
from typing import Self


class FirstPaths:
    """The first path of each key, in a temporary file, so that memory does not grow with the number of files."""

    def __init__(self) -> None:
        self._database = sqlite3.connect("")  # SQLite removes this file when it is closed
        self._database.execute("PRAGMA journal_mode = OFF")
        self._database.execute("CREATE TABLE firsts (key BLOB PRIMARY KEY, path BLOB) WITHOUT ROWID")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._database.close()

    def find(self, key: bytes) -> Path | None:
        """Return the first path that was put with this key; None if there is none."""
        row = self._database.execute("SELECT path FROM firsts WHERE key = ?", (key,)).fetchone()
        return Path(os.fsdecode(row[0])) if row else None

    def put(self, key: bytes, path: Path) -> Path | None:
        """Return the first path of this key; if there is none, remember this one and return None."""
        first = self.find(key)
        if first is None:
            self._database.execute("INSERT INTO firsts VALUES (?, ?)", (key, os.fsencode(path)))
        return first
