"""What is new of the jobs in hand, and who waits to hear it. Kept in memory only: the store has what must last."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Iterator
from contextlib import contextmanager

from unbend.jobs.progress import Report


class Listener:
    """Somebody who waits for news of a job."""

    def __init__(self, *, to_moves: bool) -> None:
        self.to_moves = to_moves
        """Whether it listens to progress too, and not only to changes of state."""
        self._changed = asyncio.Event()
        self._moved = asyncio.Event()

    def tell(self, *, changed: bool) -> None:
        """Pass on that the job moved, or that its state changed."""
        self._moved.set()
        if changed:
            self._changed.set()

    async def change(self, seconds: float) -> bool:
        """Wait until the job's state may have changed, and say whether it may; `seconds` at most."""
        return await _until_set(self._changed, seconds)

    async def move(self, seconds: float) -> None:
        """Wait until there is anything new since this was last called; `seconds` at most."""
        await _until_set(self._moved, seconds)

    def listen_anew(self) -> None:
        """Forget what was told so far. To be called before one looks, so that nothing is missed."""
        self._changed.clear()
        self._moved.clear()


class News:
    """The last report of each job in hand, and the listeners. Used within one event loop, but for `report`."""

    def __init__(self) -> None:
        self.closed = False
        """Whether nobody should wait any more."""
        self._loop: asyncio.AbstractEventLoop | None = None
        self._reports: dict[str, Report] = {}
        self._listeners: dict[str, set[Listener]] = {}

    def open(self) -> None:
        """Begin, in the event loop that runs."""
        self._loop = asyncio.get_running_loop()

    def close(self) -> None:
        """Have everybody who waits stop waiting; safe in any thread, and in a signal handler."""
        if self._loop:
            self._loop.call_soon_threadsafe(self.close_now)

    def close_now(self) -> None:
        """Have everybody who waits stop waiting."""
        self.closed = True
        for job_id in list(self._listeners):
            self.change(job_id)

    def report(self, job_id: str, report: Report) -> None:
        """Keep where a job stands; safe in any thread."""
        self._reports[job_id] = report
        # Copied, for the loop may change it meanwhile. Waking the loop for nothing would cost more than all of this.
        if self._loop and any(listener.to_moves for listener in tuple(self._listeners.get(job_id, ()))):
            self._loop.call_soon_threadsafe(self._tell, job_id, False)

    def last(self, job_id: str) -> Report | None:
        """Return the last report of a job in hand; None before the first."""
        return self._reports.get(job_id)

    def forget(self, job_id: str) -> None:
        """Drop the reports of a job that is not in hand any more."""
        self._reports.pop(job_id, None)

    def change(self, job_id: str) -> None:
        """Tell that a job's state may have changed."""
        self._tell(job_id, True)

    @contextmanager
    def listening(self, job_id: str, *, to_moves: bool = False) -> Iterator[Listener]:
        """Yield a listener that hears of a job: of its changes of state, and of its progress if asked."""
        listener = Listener(to_moves=to_moves)
        self._listeners.setdefault(job_id, set()).add(listener)
        try:
            yield listener
        finally:
            listeners = self._listeners[job_id]
            listeners.remove(listener)
            if not listeners:
                del self._listeners[job_id]

    def _tell(self, job_id: str, changed: bool) -> None:
        for listener in self._listeners.get(job_id, ()):
            listener.tell(changed=changed)


async def _until_set(event: asyncio.Event, seconds: float) -> bool:
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(seconds):
            await event.wait()
    return event.is_set()
