"""The places of results and of files in shards, on disk, so that memory does not grow with their number."""

from __future__ import annotations

import json
import os
import sqlite3
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from types import TracebackType
from typing import Self

from unbend.library.requests import UploadKey
from unbend.library.shards.entries import Entry, read_entries, read_entry
from unbend.library.shards.records import FILE, SHAPE, FileRecord, key_of

_TABLES = """
CREATE TABLE shapes (key TEXT PRIMARY KEY, path BLOB, place INTEGER) WITHOUT ROWID;
CREATE TABLE files (
    sorted BLOB, choice TEXT, written REAL, record TEXT, PRIMARY KEY (sorted, choice)
) WITHOUT ROWID;
"""
_PUT_FILE = """
INSERT INTO files VALUES (?, ?, ?, ?) ON CONFLICT DO UPDATE SET written = excluded.written, record = excluded.record
WHERE excluded.written >= files.written
"""


class ShardIndex:
    """Results by their key, and the last record of each file for each choice of parameters and policy."""

    def __init__(self) -> None:
        self._database = sqlite3.connect("")  # SQLite removes this file when it is closed
        self._database.execute("PRAGMA journal_mode = OFF")
        self._database.executescript(_TABLES)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._database.close()

    def add_shard(self, path: Path) -> None:
        """Add the entries of a finished shard.

        Raises
        ------
        ResultsError
            If it is damaged. The entries before the damage are added.
        """
        for entry in read_entries(path):
            self.add(entry)

    def add(self, entry: Entry) -> None:
        """Add an entry; ResultsError if it is malformed."""
        if entry.kind == SHAPE:
            row = (_text(key_of(entry)), os.fsencode(entry.path), entry.offset)
            self._database.execute("INSERT OR IGNORE INTO shapes VALUES (?, ?, ?)", row)
        elif entry.kind == FILE:
            self.put(FileRecord.of(entry))
        else:
            raise entry.error("the entry is of an unknown kind")

    def put(self, record: FileRecord) -> None:
        """Add the record of a file, if no later one is known."""
        text = json.dumps(record.as_dict())
        row = (_order(record.path), _choice(record.key), record.written, text)
        self._database.execute(_PUT_FILE, row)

    def put_shape(self, key: UploadKey) -> None:
        """Remember that results are written."""
        self._database.execute("INSERT OR IGNORE INTO shapes VALUES (?, x'', 0)", (_text(key),))

    def has_shape(self, key: UploadKey) -> bool:
        """Return whether there are results of this key."""
        return self._database.execute("SELECT 1 FROM shapes WHERE key = ?", (_text(key),)).fetchone() is not None

    def shape(self, key: UploadKey) -> Entry | None:
        """Return the entry of the results of this key, if there is one; ResultsError if it is damaged."""
        row = self._database.execute("SELECT path, place FROM shapes WHERE key = ?", (_text(key),)).fetchone()
        return read_entry(Path(os.fsdecode(row[0])), row[1]) if row else None

    def file(self, path: str, key: UploadKey) -> FileRecord | None:
        """Return the record of a file for the parameters and the policy of a key, if there is one."""
        row = self._database.execute(
            "SELECT record FROM files WHERE sorted = ? AND choice = ?", (_order(path), _choice(key))
        ).fetchone()
        return FileRecord.from_dict(json.loads(row[0])) if row else None

    def files(self, path: str | None = None) -> Iterator[FileRecord]:
        """Yield the records of all files in the order of their paths, or those of one path."""
        where, values = ("", ()) if path is None else ("WHERE sorted = ?", (_order(path),))
        rows = self._database.execute(f"SELECT record FROM files {where} ORDER BY sorted, choice", values)  # noqa: S608
        for (record,) in rows:
            yield FileRecord.from_dict(json.loads(record))


def _text(key: UploadKey) -> str:
    return json.dumps(list(vars(key).values()))


def _choice(key: UploadKey) -> str:
    return json.dumps([key.parameters, key.policy])


def _order(path: str) -> bytes:
    """Return a key by which paths have the order in which folders list them."""
    return "\0".join(PurePosixPath(path).parts).encode("utf-8", "surrogatepass")
