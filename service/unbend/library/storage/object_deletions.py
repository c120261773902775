"""The thread that carries out queued deletions of objects, after the transactions that queued them."""

from __future__ import annotations

import logging
import threading
import uuid
from collections.abc import Callable
from functools import partial
from typing import Any, Final, Protocol, TypeVar

from sqlalchemy import Connection

from unbend.errors import StoreError
from unbend.library.storage.object_rows import claim_deletions, finish_deletions, release_deletions
from unbend.library.storage.objects import Objects

logger = logging.getLogger("unbend.objects")
T = TypeVar("T")

_FIRST_PAUSE: Final = 1.0
_LONGEST_PAUSE: Final = 60.0


class Changes(Protocol):
    """A store of rows."""

    def change(self, change: Callable[[Connection], T]) -> T:
        """Run a change, and wait until its result is on disk."""


class ObjectDeletions:
    """Deletes objects whose deletion is queued; thread-safe. Its thread starts with the first call of `wake`."""

    def __init__(self, changes: Changes, objects: Objects) -> None:
        self._changes = changes
        self._objects = objects
        self._woken, self._closed = threading.Event(), threading.Event()
        self._lock, self._running = threading.Lock(), threading.Lock()
        self._thread: threading.Thread | None = None

    def wake(self) -> None:
        """Carry out the queued deletions soon, in another thread, and try again while they fail."""
        self._woken.set()
        with self._lock:
            if self._thread is None and not self._closed.is_set():
                self._thread = threading.Thread(target=self._work, name="unbend deletions", daemon=True)
                self._thread.start()

    def run(self) -> int:
        """Carry out all queued deletions, and return their number; those of the own thread end first.

        Raises
        ------
        StoreError
            If the object store or the database fails. The deletions then stay in the queue.
        """
        with self._running:
            return self._run()

    def close(self) -> None:
        """Carry out the queued deletions once more if there were any, and stop. Failed ones stay in the queue."""
        self._closed.set()
        self._woken.set()
        with self._lock:
            thread: Any = self._thread
        if thread is not None:
            thread.join()

    def _run(self) -> int:
        count, claim = 0, uuid.uuid4().hex
        while hashes := self._changes.change(partial(claim_deletions, claim=claim)):
            try:
                self._objects.delete(hashes)
            except StoreError:
                self._changes.change(partial(release_deletions, claim=claim))
                raise
            self._changes.change(partial(finish_deletions, claim=claim))
            count += len(hashes)
        return count

    def _work(self) -> None:
        pause = _FIRST_PAUSE
        while True:
            self._woken.wait()
            self._woken.clear()
            try:
                self.run()
                pause = _FIRST_PAUSE
            except StoreError as error:
                logger.warning("objects could not be deleted; trying again: %s", error)
                if not self._closed.wait(pause):
                    self._woken.set()
                pause = min(2 * pause, _LONGEST_PAUSE)
            if self._closed.is_set() and not self._woken.is_set():
                return
