"""The threads that run the changes of a store.

SQLite has one writer at a time: changes that wait share a transaction, so they wait for the disk once. PostgreSQL has
many, and lets their commits wait for the disk together.
"""

from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Final, Protocol, TypeVar

from sqlalchemy import Connection

from unbend.library.storage.transactions import as_store_error, is_open

logger = logging.getLogger("unbend.library")
T = TypeVar("T")

Change = Callable[[Connection], Any]

_MAX_BATCH: Final = 64
"""Largest number of changes that share a transaction. Other processes that write wait for its end."""


_MOST_AT_ONCE: Final = 4
"""Largest number of transactions that a process writes at a time. More would wait for the same disk."""


class Transactions(Protocol):
    """The transactions of a store, as the writer uses them."""

    def batch(self, change: Callable[[Connection], T]) -> T:
        """Run a change in a transaction."""

    def single(self, change: Callable[[Connection], T], *, is_statement: bool = False) -> T:
        """Run a change in a transaction; if the disk is full, again with the reserved space."""


class Writer:
    """Runs changes in the order of their submission; thread-safe.

    A change is on disk when its future has a result. A change that raises leaves nothing behind and does not affect the
    others. SQLite rolls a whole transaction back when the disk is full. Each change of that transaction then runs again
    in a transaction of its own. A change may run several times, so it must have no effect except on the store.
    """

    def __init__(self, transactions: Transactions) -> None:
        self._transactions = transactions
        self._waiting: queue.SimpleQueue[tuple[Change, Future[Any]] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="unbend writer", daemon=True)
        self._thread.start()

    def submit(self, change: Callable[[Connection], T], *, is_statement: bool = False) -> Future[T]:  # noqa: ARG002
        """Queue a change; the future has the result, or the error that the change or the store raised."""
        future: Future[T] = Future()
        self._waiting.put((change, future))
        return future

    def close(self) -> None:
        """Run the queued changes, and stop."""
        self._waiting.put(None)
        self._thread.join()

    def _run(self) -> None:
        is_closed = False
        while not is_closed:
            taken = [self._waiting.get()]
            while len(taken) < _MAX_BATCH and not self._waiting.empty():
                taken.append(self._waiting.get())
            is_closed = taken[-1] is None
            # Skip changes whose callers gave up meanwhile.
            work = [item for item in taken if item is not None and item[1].set_running_or_notify_cancel()]
            if work:
                self._write(work)

    def _write(self, work: Sequence[tuple[Change, Future[Any]]]) -> None:
        outcomes = self._write_together([change for change, _ in work]) if len(work) > 1 else None
        for index, (change, future) in enumerate(work):
            outcome = outcomes[index] if outcomes else self._write_alone(change)
            if outcome.error is None:
                future.set_result(outcome.result)
            else:
                future.set_exception(outcome.error)

    def _write_together(self, changes: Sequence[Change]) -> list[_Outcome] | None:
        """Run changes in one transaction; None if the transaction failed, so that each change must run alone."""
        try:
            return self._transactions.batch(lambda connection: [_attempt(change, connection) for change in changes])
        except Exception as error:  # noqa: BLE001  each change then runs alone, and may raise its own error
            logger.warning("%d changes were rolled back together, and run again one by one: %s", len(changes), error)
            return None

    def _write_alone(self, change: Change) -> _Outcome:
        try:
            return _Outcome(self._transactions.single(change))
        except Exception as error:  # noqa: BLE001  the caller gets every error
            return _Outcome(error=error)


class ConcurrentWriter:
    """Runs each change in a transaction of its own, several at a time; thread-safe."""

    def __init__(self, transactions: Transactions) -> None:
        self._transactions = transactions
        self._threads = ThreadPoolExecutor(_MOST_AT_ONCE, thread_name_prefix="unbend writer")

    def submit(self, change: Callable[[Connection], T], *, is_statement: bool = False) -> Future[T]:
        """Queue a change; the future has the result, or the error that the change or the store raised."""
        return self._threads.submit(self._transactions.single, change, is_statement=is_statement)

    def close(self) -> None:
        """Run the queued changes, and stop."""
        self._threads.shutdown()


@dataclass(frozen=True)
class _Outcome:
    result: Any = None
    error: Exception | None = None


class _RolledBackError(Exception):
    """The database rolled back the whole transaction."""


def _attempt(change: Change, connection: Connection) -> _Outcome:
    try:
        with as_store_error(), connection.begin_nested():
            return _Outcome(change(connection))
    except Exception as error:
        if not is_open(connection):  # later changes would run outside any transaction
            raise _RolledBackError from error
        return _Outcome(error=error)
