"""Copies of a library while it is used, and putting one back in its place while it is used."""

from __future__ import annotations

import contextlib
import os
import shutil
import sqlite3
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from unbend.errors import BackupError, ParameterError, StoreError, StoreVersionError
from unbend.library.engine import Store, make_schema, must_be_there, revisions, sqlite_file
from unbend.library.restoring import Keys, KeysChangedError, check_keys, prepare
from unbend.library.verification import check_rows, check_schema, distrust

_BUSY_SECONDS: Final = 30
_COMPANIONS: Final = ("-wal", "-shm", "-journal")
_PAGES: Final = 8
"""Copied in a step: fewer than the smallest library has, so that something can be checked before the last step."""


@dataclass(frozen=True)
class Backup:
    """A whole library in one file."""

    path: Path
    size: int
    """Bytes."""
    shapes: int
    revision: str
    """Of the schema."""


def backup(url: str, destination: str | Path, *, overwrite: bool = False) -> Backup:
    """Copy a library, which others may be writing to, into one file, which is there whole or not at all.

    Parameters
    ----------
    url : str
        The library: a path of an SQLite file, or an SQLAlchemy URL of one. Its schema is left as it is.
    destination : str or Path
    overwrite : bool, default False
        Replace the file that is there.

    Returns
    -------
    Backup
        Checked as `verify` does.

    Raises
    ------
    ParameterError
        If there is no such library, it is no SQLite file, or the destination is taken.
    StoreError
        If it cannot be copied; BackupError if it is damaged.
    """
    source, target = sqlite_file(url), Path(destination)
    must_be_there(url)
    _must_be_free(target, source, overwrite)
    with _staged(target) as staged:
        _copy(source, staged)
        found = verify(staged, source)
        shutil.copymode(source, staged)
        _sync(staged)
        staged.replace(target)
        _sync(target.parent)
    return Backup(target, found.size, found.shapes, found.revision)


def restore(source: str | Path, url: str, *, overwrite: bool = False) -> Backup:
    """Put a backup in the place of a library, which others may be using: they see the old one or the new one.

    The library's own API keys stay, if it ever had any; else the backup's come. Jobs that ran when the backup was made
    are queued. A backup of an older schema is brought up to date. Only rows are taken from the backup: the schema is
    made anew, and each row is checked as `verify` does before it counts.

    Parameters
    ----------
    source : str or Path
        Left as it is.
    url : str
        The library: a path of an SQLite file, made if it is not there, or an SQLAlchemy URL of one.
    overwrite : bool, default False
        Replace the library that is there.

    Returns
    -------
    Backup
        What was put in place.

    Raises
    ------
    ParameterError
        If there is no such backup, the library is there already, or it is no SQLite file.
    BackupError
        If the backup is damaged, or no library.
    StoreVersionError
        If the backup, or the library, was made by a later version.
    StoreError
        If the library cannot be opened, or written to.
    """
    given, target = Path(source), sqlite_file(url)
    if not given.is_file():
        raise ParameterError(f"there is no file {given}")
    if target.exists():
        if target.samefile(given):
            raise ParameterError(f"{given} is the library itself")
        if not overwrite:
            raise ParameterError(f"{target} is there already, and would be replaced")
    with _staged(target) as staged:
        _take_rows(given, staged, check_backup(given).revision, page_size=_page_size(target))
        with closing(Store(url)) as store:
            found = _put(given, staged, store)
            store.erase()
    return Backup(target, found.size, found.shapes, found.revision)


def verify(path: Path, origin: Path | None = None) -> Backup:
    """Check every page, row, hash, reference and document of a library's file.

    Of an older schema, the rows are checked as they are when they have been brought up to date, in a copy beside it.

    Parameters
    ----------
    path : Path
        Left as it is.
    origin : Path, optional
        What errors are about, where the file comes from elsewhere.

    Raises
    ------
    ParameterError
        If there is no such file.
    BackupError
        If it is no library, or damaged; the message says where.
    StoreVersionError
        If a later version made it.
    """
    if not path.is_file():
        raise ParameterError(f"there is no file {path}")
    found = check_backup(path, origin)
    if found.revision == max(revisions()):
        _check_rows(path, origin or path)
        return found
    with _staged(path) as staged:
        _take_rows(path, staged, found.revision)
        Store(str(staged)).close()
        _check_rows(staged, origin or path)
    return found


def _check_rows(path: Path, told: Path) -> None:
    try:
        with closing(_open(path)) as connection:
            distrust(connection)
            connection.execute("BEGIN")
            check_rows(connection)
    except sqlite3.DatabaseError as error:
        raise BackupError(f"{told} is damaged: {error}") from error
    except BackupError as error:
        raise BackupError(f"{told} is damaged: {error}") from error


def check_backup(path: Path, origin: Path | None = None) -> Backup:
    """Look at every page of a library's file; errors are about `origin` if that is where it comes from.

    Raises
    ------
    BackupError
        If it is no library, or damaged.
    StoreVersionError
        If a later version made it.
    """
    told = origin or path
    try:
        with closing(_open(path)) as connection:
            distrust(connection)
            revision, shapes = _look_through(connection)
    except sqlite3.DatabaseError as error:
        raise BackupError(f"{told} is no library, or damaged: {error}") from error
    except BackupError as error:
        raise BackupError(f"{told} {error}") from None
    if revision not in revisions():
        raise StoreVersionError(f"{told} was made by a later version of unbend")
    return Backup(path, path.stat().st_size, shapes, revision)


def _look_through(connection: sqlite3.Connection) -> tuple[str, int]:
    """Return the revision of a library's schema, and how many shapes it has; BackupError begins with a verb."""
    tables = {name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    if not {"alembic_version", "shapes", "meshes", "jobs"} <= tables:
        raise BackupError("is no library of unbend")
    check_schema(connection)
    faults = [text for (text,) in connection.execute("PRAGMA integrity_check(1)") if text != "ok"]
    faults += [f"a row of {row[0]} refers to nothing" for row in connection.execute("PRAGMA foreign_key_check")]
    if faults:
        raise BackupError(f"is damaged: {faults[0].splitlines()[-1]}")
    (revision,) = connection.execute("SELECT max(version_num) FROM alembic_version").fetchone()
    (shapes,) = connection.execute("SELECT count(*) FROM shapes").fetchone()
    return str(revision), int(shapes)


def _must_be_free(target: Path, source: Path, overwrite: bool) -> None:
    if target.exists():
        if target.samefile(source):
            raise ParameterError(f"{target} is the library itself")
        if not overwrite or not target.is_file():
            raise ParameterError(f"{target} is there already")
    for ending in _COMPANIONS:
        if Path(f"{target}{ending}").exists():  # it would be taken for the new file's
            raise ParameterError(f"{target}{ending} is there: the file is open as a library, or was not closed")


@contextmanager
def _staged(target: Path) -> Iterator[Path]:
    """Yield a new file beside `target`, for this user's eyes only, that is gone afterwards unless it was moved."""
    if not target.parent.is_dir():
        raise ParameterError(f"there is no folder {target.parent}")
    handle, name = tempfile.mkstemp(prefix=f".{target.name[:40]}-", suffix=".part", dir=target.parent)
    os.close(handle)
    try:
        yield Path(name)
    finally:
        for path in (name, *(name + ending for ending in _COMPANIONS)):
            Path(path).unlink(missing_ok=True)


def _open(path: Path) -> sqlite3.Connection:
    """Open a file that must be there already."""
    address = f"{path.resolve().as_uri()}?mode=rw"
    return sqlite3.connect(address, uri=True, isolation_level=None, timeout=_BUSY_SECONDS)


def _take_rows(source: Path, empty: Path, revision: str, page_size: int | None = None) -> None:
    """Copy the rows of one state of a library into a schema of our own making; nothing else of the file comes along."""
    try:
        if page_size:
            with closing(_open(empty)) as connection:
                connection.execute(f"PRAGMA page_size = {page_size}")
                connection.execute("VACUUM")
        make_schema(empty, revision)
        with closing(_open(empty)) as connection:
            distrust(connection)
            connection.execute("PRAGMA foreign_keys = OFF")
            connection.execute("ATTACH ? AS given", (f"{source.resolve().as_uri()}?mode=rw",))
            connection.execute("BEGIN")
            for table, columns in _columns(connection).items():
                _take_table(connection, table, columns, source)
            connection.execute("COMMIT")
            connection.execute("DETACH given")
    except sqlite3.DatabaseError as error:
        raise BackupError(f"{source} is damaged: {error}") from error


def _columns(connection: sqlite3.Connection) -> dict[str, list[str]]:
    """Return the tables of our own schema with their columns; what counts automatic keys comes last."""
    tables = [name for (name,) in connection.execute("SELECT name FROM main.sqlite_master WHERE type = 'table'")]
    return {
        table: [row[1] for row in connection.execute(f"PRAGMA main.table_info('{table}')")]
        for table in sorted(tables, key=lambda name: name == "sqlite_sequence")
        if table != "alembic_version"
    }


def _take_table(connection: sqlite3.Connection, table: str, columns: list[str], source: Path) -> None:
    there = {row[1] for row in connection.execute(f"PRAGMA given.table_info('{table}')")}
    if missing := set(columns) - there:
        raise BackupError(f"{source} is damaged: its table {table} has no {min(missing)}")
    named = ", ".join(columns)
    connection.execute(f"DELETE FROM main.{table}")  # noqa: S608  names of our own schema
    connection.execute(f"INSERT INTO main.{table} ({named}) SELECT {named} FROM given.{table}")  # noqa: S608


def _copy(source: Path, empty: Path) -> None:
    """Copy one state of a database. Pages that nothing is in, and may have held something, are left behind."""
    try:
        with closing(_open(source)) as connection:
            connection.execute("VACUUM INTO ?", (str(empty.resolve()),))
    except sqlite3.DatabaseError as error:
        raise StoreError(f"{source} cannot be copied: {error}") from error


def _page_size(path: Path) -> int | None:
    """Return the size of a database's pages, which cannot be changed while it is used; None where there is none."""
    if not path.exists() or not path.stat().st_size:
        return None
    try:
        with closing(_open(path)) as connection:
            return int(connection.execute("PRAGMA page_size").fetchone()[0])
    except sqlite3.DatabaseError as error:
        raise StoreError(f"{path} cannot be opened: {error}") from error


class _Watch:
    """Looks on while a library is written over. From the first step on, nobody else can write to it."""

    def __init__(self, store: Store, keys: Keys) -> None:
        self._store = store
        self._keys = keys
        self._checked = False

    def __call__(self, status: int, _left: int, _all: int) -> None:
        if status in {sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED}:
            raise StoreError(f"somebody else has been writing to the library for {_BUSY_SECONDS} seconds")
        if not self._checked:
            check_keys(self._store, self._keys)
            self._checked = True


def _put(given: Path, staged: Path, store: Store) -> Backup:
    """Make a staged library ready and copy it over `store`, in one transaction."""
    while True:
        keys = prepare(staged, store)
        found = check_backup(staged)
        _check_rows(staged, given)
        with contextlib.suppress(KeysChangedError):
            _copy_over(staged, store, _Watch(store, keys))
            return found


def _copy_over(staged: Path, store: Store, watch: _Watch) -> None:
    try:
        with closing(_open(staged)) as source, store.driver_connection() as target:
            source.backup(target, pages=_PAGES, progress=watch)
    except sqlite3.DatabaseError as error:
        raise StoreError(f"the library at {store.url} cannot be written: {error}") from error


def _sync(path: Path) -> None:
    """Have a file, or a folder's list of files, on disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
