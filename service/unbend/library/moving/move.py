"""Moves of a whole library between databases, row by row, and checked row by row."""

from __future__ import annotations

import hashlib
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from sqlalchemy import Connection, Table, func, select, update
from sqlalchemy.exc import DataError, IntegrityError, ProgrammingError

from unbend.brief import counted
from unbend.errors import BackupError, ExistsError, MoveError, StoreError, StoreUnavailableError
from unbend.library.backups.backup import verify
from unbend.library.moving.ends import TABLES, inspect_target, opened_source, opened_target, prepare_target
from unbend.library.moving.rows import Key, RawTable, Values
from unbend.library.moving.sequences import read_counters, set_counters
from unbend.library.storage import unfinished
from unbend.library.storage.database import shown_url
from unbend.library.storage.schema import api_keys, jobs, library_state, meshes
from unbend.library.storage.transactions import as_store_error

BATCH_BYTES: Final = 8 * 2**20
"""Bytes of a batch of rows. A larger row is a batch of its own."""

_REFUSALS: Final = (DataError, IntegrityError, ProgrammingError)
"""Errors of a row that a database does not store."""

_NEW: Final = "Name a new, empty database."
_CHANGED: Final = "Stop what writes to it, and run the same command again."
_CHECK: Final = "Check the addresses of the source and the target."
_AGAIN: Final = "Run the same command again: it goes on where it was."


@dataclass(frozen=True)
class Progress:
    """The progress of a move."""

    table: str
    """The table that is being copied."""
    rows: int
    """Number of its rows that are at the target."""
    of: int
    """Number of its rows at the source."""


@dataclass(frozen=True)
class Move:
    """A finished move."""

    rows: dict[str, int]
    """Number of rows by table. Each was read back from the target and compared."""
    copied: int
    """Number of rows that this run copied; the others were at the target already."""
    requeued: int
    """Number of jobs that ran at the source, and are queued at the target."""


def move_library(
    source: str,
    target: str,
    *,
    progress: Callable[[Progress], None] = lambda _: None,
    batch_bytes: int = BATCH_BYTES,
) -> Move:
    """Copy a whole library to another database, so that ids, pages, jobs, keys and answers are the same there.

    The source stays unchanged. A hash of each row, read back from the target, is compared with that of the source. A
    move that was interrupted, at any moment, goes on where it was if it is called again: rows that are at the target
    are compared. Until it is complete, the target does not open as a library. Jobs that ran are queued.

    Parameters
    ----------
    source, target : str
        A path of an SQLite file, or an SQLAlchemy URL. The target is a new file, or an empty database.
    progress : callable, optional
        Called after each batch of rows.
    batch_bytes : int, default 8 MiB
        Bytes of the rows that are in memory at a time. A larger row is in memory alone.

    Returns
    -------
    Move
        If the target has the whole library already, nothing is changed, and `copied` is 0.

    Raises
    ------
    ParameterError
        If there is no such source; ExistsError if the target holds anything else.
    StoreInUseError
        If a server or a worker uses the source or the target.
    StoreOutdatedError
        If the source has an older schema.
    BackupError
        If the source, an SQLite file, is damaged.
    MoveError
        If a row cannot be stored at the target, or differs from the row there. The message names the row.
    StoreError
        If one of the databases cannot be used, or the source changed meanwhile.
    """
    with _explained(_CHECK), opened_source(source) as given:
        origin = _fingerprint(given.connection)
        state = inspect_target(target, origin.epoch)
        if state == "new" and given.path:
            _verify(given.path)
        with opened_target(target) as taken, _explained(_AGAIN):
            copy = _Copy(given.connection, taken.connection, progress, batch_bytes)
            if state == "full":
                return _compared(copy, shown_url(target))
            if state == "new":
                prepare_target(taken, origin.epoch)
            counters = read_counters(given.connection)
            rows = {table.name: copy.table(table) for table in TABLES}
            given.connection.rollback()  # to see what has changed since
            if _fingerprint(given.connection) != origin:
                raise StoreError("the source was changed while it was copied").with_advice(_CHANGED)
            _finish(taken.connection, origin, counters)
    return Move(rows, copy.copied, copy.requeued)


@dataclass(frozen=True)
class _Fingerprint:
    """The counters and the epoch, which change with a library's rows."""

    epoch: str
    revision: int
    others: tuple[Any, ...]
    """Numbers of jobs and keys."""


def _fingerprint(connection: Connection) -> _Fingerprint:
    epoch, revision = connection.execute(select(library_state.c.epoch, library_state.c.revision)).one()
    by_state = select(jobs.c.state, func.count(), func.max(jobs.c.seq)).group_by(jobs.c.state).order_by(jobs.c.state)
    keys = select(func.count(), func.count(api_keys.c.revoked_at)).select_from(api_keys)
    others = (*map(tuple, connection.execute(by_state)), tuple(connection.execute(keys).one()))
    return _Fingerprint(epoch, revision, others)


class _Copy:
    """Copies tables in batches, and compares each row at the target with the source."""

    def __init__(
        self, source: Connection, target: Connection, progress: Callable[[Progress], None], batch_bytes: int
    ) -> None:
        self._source = source
        self._target = target
        self._progress = progress
        self._batch_bytes = batch_bytes
        self.copied = 0
        self.requeued = 0

    def table(self, table: Table) -> int:
        """Copy the rows of a table that the target does not have, and return the number of all rows."""
        return self._each_batch(table, self._copy)

    def compare(self, table: Table) -> int:
        """Compare a table, and return the number of its rows; MoveError if it is different at the target."""
        given, taken = RawTable(self._source, table), RawTable(self._target, table)
        self._must_have(taken, given.count())  # first, because it is quick
        return self._each_batch(table, self._compare)

    def _each_batch(self, table: Table, work: Callable[[RawTable, dict[Key, Values]], None]) -> int:
        given, taken = RawTable(self._source, table), RawTable(self._target, table)
        done, total = 0, given.count()
        self._progress(Progress(table.name, 0, total))
        for keys in _batches(given, self._batch_bytes):
            rows = given.read(keys)
            self.requeued += sum(_prepare(given, values) for values in rows.values())
            work(taken, rows)
            done += len(keys)
            self._progress(Progress(table.name, done, total))
        self._must_have(taken, done)
        return done

    def _copy(self, taken: RawTable, rows: dict[Key, Values]) -> None:
        wanted = _digests(taken, rows)
        missing = self._missing(taken, wanted)
        if not missing:
            return
        self._store(taken, [rows[key] for key in missing])
        self.copied += len(missing)
        rows.clear()  # so that the rows are in memory once
        if lost := self._missing(taken, {key: wanted[key] for key in missing}):
            raise MoveError(f"{taken.named(lost[0])} is not at the target, though it was stored there")

    def _compare(self, taken: RawTable, rows: dict[Key, Values]) -> None:
        if missing := self._missing(taken, _digests(taken, rows)):
            raise MoveError(f"{taken.named(missing[0])} is not at the target")

    def _must_have(self, taken: RawTable, wanted: int) -> None:
        with self._target.begin():
            found = taken.count()
        if found != wanted:
            raise MoveError(f"{taken.name} has {counted(found, 'row')} at the target, and {wanted} at the source")

    def _missing(self, taken: RawTable, wanted: Mapping[Key, bytes]) -> list[Key]:
        """Compare rows at the target, and return the keys of those that it does not have."""
        with self._target.begin():
            found = taken.digests(list(wanted))
        for key, digest in found.items():
            if digest != wanted[key]:
                raise MoveError(f"{taken.named(key)} is different at the target")
        return [key for key in wanted if key not in found]

    def _store(self, taken: RawTable, rows: Sequence[Values]) -> None:
        try:
            with self._target.begin():
                taken.insert(rows)
        except _REFUSALS:
            for values in rows:
                self._store_one(taken, values)

    def _store_one(self, taken: RawTable, values: Values) -> None:
        try:
            with self._target.begin():
                taken.insert([values])
        except _REFUSALS as error:
            raise taken.refusal(values, error) from error


def _digests(table: RawTable, rows: Mapping[Key, Values]) -> dict[Key, bytes]:
    return {key: table.digest(values) for key, values in rows.items()}


def _batches(given: RawTable, most_bytes: int) -> Iterator[list[Key]]:
    """Yield the keys of a table in batches whose rows have at most so many bytes, or are one."""
    last: Key | None = None
    while page := given.keys(last):
        batch: list[Key] = []
        size = 0
        for key, row_bytes in page:
            if batch and size + row_bytes > most_bytes:
                yield batch
                batch, size = [], 0
            batch.append(key)
            size += row_bytes
        yield batch
        last = page[-1][0]


def _prepare(given: RawTable, values: Values) -> bool:
    """Check a file, or free a job from what belongs to the source; return whether the job ran there.

    The job's ticket was one of the source's queue. Its place in the queue, and its attempts, are then as if the server
    had stopped (see `job_rows.requeue`).
    """
    if given.name == meshes.name:
        is_here = values["data"] is not None  # otherwise an object store has the file, before and after
        if is_here and hashlib.sha256(values["data"]).hexdigest() != values["sha256"]:
            raise MoveError(f"{given.named(given.key_of(values))} is damaged: it is not the uploaded file")
        return False
    if given.name != jobs.name:
        return False
    values["ticket"] = None
    if values["state"] != "running":
        return False
    values |= {"state": "queued", "stage": "queued", "started_at": None, "attempts": values["attempts"] - 1}
    return True


def _compared(copy: _Copy, name: str) -> Move:
    """Return the move that an earlier run finished; ExistsError if the target holds anything else."""
    try:
        return Move({table.name: copy.compare(table) for table in TABLES}, 0, copy.requeued)
    except MoveError as error:
        raise ExistsError(f"{name} is not empty, and not the same library: {error}").with_advice(_NEW) from error


def _verify(source: Path) -> None:
    try:
        verify(source)
    except BackupError as error:
        raise error.with_advice("Restore a backup of the source first; see `unbend restore --help`.") from None


def _finish(target: Connection, origin: _Fingerprint, counters: Mapping[str, int]) -> None:
    """Make a complete target a library: with its counters, and an epoch that no cache knows."""
    with target.begin():
        set_counters(target, counters)
        target.execute(update(library_state).values(revision=origin.revision, epoch=uuid.uuid4().hex))
        unfinished.end(target)


@contextmanager
def _explained(advice: str) -> Iterator[None]:
    """Replace the errors of databases by StoreError, and give advice on those that have none."""
    try:
        with as_store_error():
            yield
    except StoreError as error:
        if not error.advice or isinstance(error, StoreUnavailableError):
            error.with_advice(advice)
        raise
