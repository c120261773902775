"""One thread that writes: changes that wait together share a transaction, at the price of one wait for the disk."""

from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any, Final, TypeVar

from sqlalchemy import Connection

from unbend.library.engine import Store, failing_as_store, is_open

logger = logging.getLogger("unbend.library")
T = TypeVar("T")

Change = Callable[[Connection], Any]

_MOST: Final = 64
"""Changes that share a transaction: others wait for the store as long as it lasts."""


class Writer:
    """Makes changes in the order they were asked for; thread-safe.

    A change is on disk when its future has a result. One that raises leaves nothing behind, and the others as they are.
    SQLite undoes a whole transaction where the disk is full. Each change of that transaction is then made again, in a
    transaction of its own: a change may be called twice, so it must have no effect but on the store.
    """

    def __init__(self, store: Store) -> None:
        self._store = store
        self._waiting: queue.SimpleQueue[tuple[Change, Future[Any]] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="unbend writer", daemon=True)
        self._thread.start()

    def submit(self, change: Callable[[Connection], T]) -> Future[T]:
        """Have a change made; the future has what it returns, or raises what it, or the store, raised."""
        future: Future[T] = Future()
        self._waiting.put((change, future))
        return future

    def close(self) -> None:
        """Make what was asked for, and end."""
        self._waiting.put(None)
        self._thread.join()

    def _run(self) -> None:
        open_ = True
        while open_:
            taken = [self._waiting.get()]
            while len(taken) < _MOST and not self._waiting.empty():
                taken.append(self._waiting.get())
            open_ = taken[-1] is not None
            # One that nobody waits for any more is not begun.
            works = [work for work in taken if work is not None and work[1].set_running_or_notify_cancel()]
            if works:
                self._make(works)

    def _make(self, works: Sequence[tuple[Change, Future[Any]]]) -> None:
        outcomes = self._together([change for change, _ in works]) if len(works) > 1 else None
        for index, (change, future) in enumerate(works):
            outcome = outcomes[index] if outcomes else self._alone(change)
            if outcome.failure is None:
                future.set_result(outcome.result)
            else:
                future.set_exception(outcome.failure)

    def _together(self, changes: Sequence[Change]) -> list[_Outcome] | None:
        """Make changes in one transaction; None if it was undone, and with it every change."""
        try:
            with self._store.write() as connection:
                return [_attempt(change, connection) for change in changes]
        except Exception as error:  # noqa: BLE001  each of them finds out for itself what stands in the way
            logger.warning("%d changes were undone together, and are made one by one: %s", len(changes), error)
            return None

    def _alone(self, change: Change) -> _Outcome:
        try:
            return _Outcome(self._store.change(change))
        except Exception as error:  # noqa: BLE001  whatever it is, the one who waits is told
            return _Outcome(failure=error)


@dataclass(frozen=True)
class _Outcome:
    result: Any = None
    failure: Exception | None = None


class _UndoneError(Exception):
    """The database undid the whole transaction."""


def _attempt(change: Change, connection: Connection) -> _Outcome:
    try:
        with failing_as_store(), connection.begin_nested():
            return _Outcome(change(connection))
    except Exception as error:
        if not is_open(connection):  # what comes now would be kept without a transaction
            raise _UndoneError from error
        return _Outcome(failure=error)
