"""Backups of a library in use, and their restoration into a library in use."""

from __future__ import annotations

import contextlib
import os
import shutil
import sqlite3
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from unbend.errors import BackupError, ExistsError, ParameterError, StoreError, StoreVersionError
from unbend.library.backups.staging import KeyRows, KeysChangedError, check_keys, prepare
from unbend.library.backups.verification import check_rows, check_schema, distrust
from unbend.library.storage.database import create_schema, must_exist, revisions, sqlite_file
from unbend.library.storage.disk import sync
from unbend.library.storage.store import Store

_BUSY_SECONDS: Final = 30
_COMPANIONS: Final = ("-wal", "-shm", "-journal")
_PAGES: Final = 8
"""Pages copied in a step: fewer than the smallest library has, so that a check can run before the last step."""


@dataclass(frozen=True)
class Backup:
    """A whole library in one file."""

    path: Path
    size: int
    """Size in bytes."""
    shapes: int
    revision: str
    """The revision of the schema."""
    elsewhere: int = 0
    """Number of files that are in an object store, and not in this file."""


def backup(url: str, destination: str | Path, *, overwrite: bool = False) -> Backup:
    """Copy a library into one file, while others may write to the library. The file appears complete or not at all.

    Parameters
    ----------
    url : str
        A path of an SQLite file, or an SQLAlchemy URL of one. Its schema stays unchanged.
    destination : str or Path
    overwrite : bool, default False
        Replace an existing file.

    Returns
    -------
    Backup
        The copy, checked as by `verify`.

    Raises
    ------
    ParameterError
        If there is no such library, or it is not an SQLite file; ExistsError if the destination exists.
    StoreError
        If it cannot be copied; BackupError if it is damaged.
    """
    source, target = sqlite_file(url), Path(destination)
    must_exist(url)
    _must_be_free(target, source, overwrite)
    with _staged(target) as staged:
        _copy(source, staged)
        found = verify(staged, source)
        shutil.copymode(source, staged)
        sync(staged)
        staged.replace(target)
        sync(target.parent)
    return replace(found, path=target)


def restore(source: str | Path, url: str, *, overwrite: bool = False) -> Backup:
    """Replace a library by a backup, while others may use it: they see the old library or the new one.

    If the library ever had API keys, it keeps them; otherwise it gets those of the backup. Jobs that ran when the
    backup was made are queued. A backup of an older schema is migrated. Only rows are copied from the backup, into a
    new schema, and each is checked as by `verify`.

    Parameters
    ----------
    source : str or Path
        The backup; it stays unchanged.
    url : str
        A path of an SQLite file, which is created if it is missing, or an SQLAlchemy URL of one.
    overwrite : bool, default False
        Replace an existing library.

    Returns
    -------
    Backup
        The restored library.

    Raises
    ------
    ParameterError
        If there is no such backup, or the library is not an SQLite file; ExistsError if it exists already.
    BackupError
        If the backup is damaged, or is not a library.
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
            raise ExistsError(f"{target} exists already, and would be replaced")
    with _staged(target) as staged:
        _copy_rows(given, staged, check_backup(given).revision, page_size=_page_size(target))
        with closing(Store(url)) as store:
            found = _replace_content(given, staged, store)
            store.erase()
    return replace(found, path=target)


def verify(path: Path, origin: Path | None = None) -> Backup:
    """Check every page, row, hash, reference and document of a library's file.

    Rows of an older schema are migrated in a temporary copy before they are checked.

    Parameters
    ----------
    path : Path
        The file; it stays unchanged.
    origin : Path, optional
        The path that errors name, if `path` is a copy.

    Raises
    ------
    ParameterError
        If there is no such file.
    BackupError
        If it is not a library, or damaged; the message says where.
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
        _copy_rows(path, staged, found.revision)
        Store(str(staged)).close()
        _check_rows(staged, origin or path)
    return found


def _check_rows(path: Path, named: Path) -> None:
    try:
        with closing(_open(path)) as connection:
            distrust(connection)
            connection.execute("BEGIN")
            check_rows(connection)
    except sqlite3.DatabaseError as error:
        raise BackupError(f"{named} is damaged: {error}") from error
    except BackupError as error:
        raise BackupError(f"{named} is damaged: {error}") from error


def check_backup(path: Path, origin: Path | None = None) -> Backup:
    """Check every page of a library's file; errors name `origin` if it is given.

    Raises
    ------
    BackupError
        If it is not a library, or damaged.
    StoreVersionError
        If a later version made it.
    """
    named = origin or path
    try:
        with closing(_open(path)) as connection:
            distrust(connection)
            revision, shapes, elsewhere = _inspect(connection)
    except sqlite3.DatabaseError as error:
        raise BackupError(f"{named} is not a library, or damaged: {error}") from error
    except BackupError as error:
        raise BackupError(f"{named} {error}") from None
    if revision not in revisions():
        raise StoreVersionError(f"{named} was made by a later version of unbend")
    return Backup(path, path.stat().st_size, shapes, revision, elsewhere)


def _inspect(connection: sqlite3.Connection) -> tuple[str, int, int]:
    """Return the revision of the schema, and the numbers of shapes and of files in an object store.

    Messages of BackupError begin with a verb.
    """
    tables = {name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    if not {"alembic_version", "shapes", "meshes", "jobs"} <= tables:
        raise BackupError("is not a library of unbend")
    check_schema(connection)
    faults = [text for (text,) in connection.execute("PRAGMA integrity_check(1)") if text != "ok"]
    faults += [f"a row of {row[0]} refers to nothing" for row in connection.execute("PRAGMA foreign_key_check")]
    if faults:
        raise BackupError(f"is damaged: {faults[0].splitlines()[-1]}")
    (revision,) = connection.execute("SELECT max(version_num) FROM alembic_version").fetchone()
    (shapes,) = connection.execute("SELECT count(*) FROM shapes").fetchone()
    (elsewhere,) = connection.execute("SELECT count(*) FROM meshes WHERE data IS NULL").fetchone()
    return str(revision), int(shapes), int(elsewhere)


def _must_be_free(target: Path, source: Path, overwrite: bool) -> None:
    if target.exists():
        if target.samefile(source):
            raise ParameterError(f"{target} is the library itself")
        if not target.is_file():
            raise ParameterError(f"{target} exists already, and is not a file")
        if not overwrite:
            raise ExistsError(f"{target} exists already, and would be replaced")
    for ending in _COMPANIONS:
        if Path(f"{target}{ending}").exists():  # SQLite would treat it as part of the new file
            raise ParameterError(f"{target}{ending} exists: the file is open as a library, or was not closed")


@contextmanager
def _staged(target: Path) -> Iterator[Path]:
    """Yield a new private file in the folder of `target`; it is deleted afterwards, unless it was moved."""
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
    """Open an existing file."""
    address = f"{path.resolve().as_uri()}?mode=rw"
    return sqlite3.connect(address, uri=True, isolation_level=None, timeout=_BUSY_SECONDS)


def _copy_rows(source: Path, empty: Path, revision: str, page_size: int | None = None) -> None:
    """Copy only the rows of one state of a library into a new schema."""
    try:
        if page_size:
            with closing(_open(empty)) as connection:
                connection.execute(f"PRAGMA page_size = {page_size}")
                connection.execute("VACUUM")
        create_schema(empty, revision)
        with closing(_open(empty)) as connection:
            distrust(connection)
            connection.execute("PRAGMA foreign_keys = OFF")
            connection.execute("ATTACH ? AS given", (f"{source.resolve().as_uri()}?mode=rw",))
            connection.execute("BEGIN")
            for table, columns in _columns(connection).items():
                _copy_table(connection, table, columns, source)
            connection.execute("COMMIT")
            connection.execute("DETACH given")
    except sqlite3.DatabaseError as error:
        raise BackupError(f"{source} is damaged: {error}") from error


def _columns(connection: sqlite3.Connection) -> dict[str, list[str]]:
    """Return the tables of the new schema with their columns; sqlite_sequence comes last, because inserts change it."""
    tables = [name for (name,) in connection.execute("SELECT name FROM main.sqlite_master WHERE type = 'table'")]
    return {
        table: [row[1] for row in connection.execute(f"PRAGMA main.table_info('{table}')")]
        for table in sorted(tables, key=lambda name: name == "sqlite_sequence")
        if table != "alembic_version"
    }


def _copy_table(connection: sqlite3.Connection, table: str, columns: list[str], source: Path) -> None:
    present = {row[1] for row in connection.execute(f"PRAGMA given.table_info('{table}')")}
    if missing := set(columns) - present:
        raise BackupError(f"{source} is damaged: its table {table} has no {min(missing)}")
    named = ", ".join(columns)
    connection.execute(f"DELETE FROM main.{table}")  # noqa: S608  names of the present schema
    connection.execute(f"INSERT INTO main.{table} ({named}) SELECT {named} FROM given.{table}")  # noqa: S608


def _copy(source: Path, empty: Path) -> None:
    """Copy one state of a database, without its free pages, which may contain deleted content."""
    try:
        with closing(_open(source)) as connection:
            connection.execute("VACUUM INTO ?", (str(empty.resolve()),))
    except sqlite3.DatabaseError as error:
        raise StoreError(f"{source} cannot be copied: {error}") from error


def _page_size(path: Path) -> int | None:
    """Return the page size of a database, which cannot change while it is in use; None if there is no file."""
    if not path.exists() or not path.stat().st_size:
        return None
    try:
        with closing(_open(path)) as connection:
            return int(connection.execute("PRAGMA page_size").fetchone()[0])
    except sqlite3.DatabaseError as error:
        raise StoreError(f"{path} cannot be opened: {error}") from error


class _KeyCheck:
    """Checks the keys of a library after the first step of overwriting it: no other process can write from then on."""

    def __init__(self, store: Store, keys: KeyRows) -> None:
        self._store = store
        self._keys = keys
        self._checked = False

    def __call__(self, status: int, _left: int, _all: int) -> None:
        if status in {sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED}:
            raise StoreError(f"another process has been writing to the library for {_BUSY_SECONDS} seconds")
        if not self._checked:
            check_keys(self._store, self._keys)
            self._checked = True


def _replace_content(given: Path, staged: Path, store: Store) -> Backup:
    """Prepare a staged library, and copy it over `store` in one transaction."""
    while True:
        keys = prepare(staged, store)
        found = check_backup(staged)
        _check_rows(staged, given)
        with contextlib.suppress(KeysChangedError):
            _copy_over(staged, store, _KeyCheck(store, keys))
            return found


def _copy_over(staged: Path, store: Store, check: _KeyCheck) -> None:
    try:
        with closing(_open(staged)) as source, store.driver_connection() as target:
            source.backup(target, pages=_PAGES, progress=check)
    except sqlite3.DatabaseError as error:
        raise StoreError(f"the library at {store.url} cannot be written: {error}") from error
