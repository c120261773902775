"""One thread that writes: what waits together is kept together, at the price of one wait for the disk."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, Final, TypeVar

from sqlalchemy import Connection

from unbend.library.engine import Store, failing_as_store

T = TypeVar("T")

Change = Callable[[Connection], Any]

_MOST: Final = 64
"""Changes that share a transaction: others wait for the store as long as it lasts."""


class Writer:
    """Makes changes in the order they were asked for; thread-safe.

    A change is on disk when its future has a result. One that raises leaves nothing behind, and the others as they are.
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

    def _make(self, works: list[tuple[Change, Future[Any]]]) -> None:
        outcomes: list[tuple[Any, Exception | None]] = []
        try:
            with self._store.write() as connection:
                if len(works) == 1:
                    outcomes.append((works[0][0](connection), None))
                else:
                    outcomes += [_attempt(change, connection) for change, _ in works]
        except Exception as error:  # noqa: BLE001  whatever it is, those who wait are told
            outcomes = [(None, error)] * len(works)
        for (_, future), (result, failure) in zip(works, outcomes, strict=True):
            if failure is None:
                future.set_result(result)
            else:
                future.set_exception(failure)


def _attempt(change: Change, connection: Connection) -> tuple[Any, Exception | None]:
    try:
        with failing_as_store(), connection.begin_nested():
            return change(connection), None
    except Exception as error:  # noqa: BLE001  it is that change's alone
        return None, error
