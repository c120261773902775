"""Subscriptions to jobs, and the latest progress of running jobs; in memory only."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Iterator
from contextlib import contextmanager

from unbend.progress import Progress


class Subscription:
    """One subscriber to a job."""

    def __init__(self, *, to_progress: bool) -> None:
        self.to_progress = to_progress
        """Whether the subscriber receives progress, in addition to changes of state."""
        self._state_event = asyncio.Event()
        self._any_event = asyncio.Event()

    def notify(self, *, state_changed: bool) -> None:
        """Notify the subscriber of progress, or of a change of state."""
        self._any_event.set()
        if state_changed:
            self._state_event.set()

    async def wait_for_state(self, seconds: float) -> bool:
        """Wait up to `seconds` for a change of state; return whether there was a change since `clear`."""
        return await _wait(self._state_event, seconds)

    async def wait(self, seconds: float) -> None:
        """Wait up to `seconds` for progress or a change of state since `clear`."""
        await _wait(self._any_event, seconds)

    def clear(self) -> None:
        """Clear earlier notifications. Call it before reading the job, so that no change is missed."""
        self._state_event.clear()
        self._any_event.clear()


class JobFeed:
    """One subscriber to all jobs: collects the ids of jobs that changed."""

    def __init__(self) -> None:
        self._changed: dict[str, None] = {}
        self._event = asyncio.Event()

    def notify(self, job_id: str) -> None:
        """Note that a job has progressed, or changed its state."""
        self._changed[job_id] = None
        self._event.set()

    def wake(self) -> None:
        """End a wait without a change."""
        self._event.set()

    async def wait(self, seconds: float) -> list[str]:
        """Wait up to `seconds` for a change; return the ids of jobs that changed since the last call.

        The ids are in the order in which the jobs first changed.
        """
        await _wait(self._event, seconds)
        changed = list(self._changed)
        self._changed.clear()
        self._event.clear()
        return changed


class Subscriptions:
    """The subscribers and the latest progress of jobs.

    Used within one event loop, except that `report` and `close_soon` are safe in any thread.
    """

    def __init__(self) -> None:
        self.closed = False
        """Whether `close` was called: callers must then not begin another wait."""
        self._loop: asyncio.AbstractEventLoop | None = None
        self._progress: dict[str, Progress] = {}
        self._subscribers: dict[str, set[Subscription]] = {}
        self._feeds: set[JobFeed] = set()

    def open(self) -> None:
        """Attach to the running event loop."""
        self._loop = asyncio.get_running_loop()

    def close_soon(self) -> None:
        """Call `close` in the event loop; safe in any thread and in a signal handler."""
        if self._loop:
            self._loop.call_soon_threadsafe(self.close)

    def close(self) -> None:
        """Set `closed`, and end the waits that have begun."""
        self.closed = True
        for job_id in list(self._subscribers):
            self.notify_state(job_id)
        for feed in self._feeds:
            feed.wake()

    def report(self, job_id: str, progress: Progress) -> None:
        """Keep the latest progress of a job, and notify its subscribers; safe in any thread."""
        self._progress[job_id] = progress
        # A copy, because the event loop may change the set meanwhile. Waking the loop for nobody would cost more.
        heard = self._feeds or any(each.to_progress for each in tuple(self._subscribers.get(job_id, ())))
        if self._loop and heard:
            self._loop.call_soon_threadsafe(self._notify, job_id, False)

    def progress(self, job_id: str) -> Progress | None:
        """Return the latest progress of a running job; None before the first report."""
        return self._progress.get(job_id)

    def discard(self, job_id: str) -> None:
        """Discard the progress of a job that no longer runs."""
        self._progress.pop(job_id, None)

    def notify_state(self, job_id: str) -> None:
        """Notify the subscribers of a job that its state may have changed."""
        self._notify(job_id, True)

    def notify_all(self) -> None:
        """Notify all subscribers that anything may have happened to their jobs, and forget all progress."""
        self._progress.clear()
        for job_id in list(self._subscribers):
            self.notify_state(job_id)

    @contextmanager
    def subscribe(self, job_id: str, *, to_progress: bool = False) -> Iterator[Subscription]:
        """Yield a subscription to a job's changes of state, and to its progress if `to_progress`."""
        subscription = Subscription(to_progress=to_progress)
        self._subscribers.setdefault(job_id, set()).add(subscription)
        try:
            yield subscription
        finally:
            subscribers = self._subscribers[job_id]
            subscribers.remove(subscription)
            if not subscribers:
                del self._subscribers[job_id]

    @contextmanager
    def subscribe_to_all(self) -> Iterator[JobFeed]:
        """Yield a subscription to the progress and changes of state of all jobs."""
        feed = JobFeed()
        self._feeds.add(feed)
        try:
            yield feed
        finally:
            self._feeds.remove(feed)

    def _notify(self, job_id: str, state_changed: bool) -> None:
        for subscription in self._subscribers.get(job_id, ()):
            subscription.notify(state_changed=state_changed)
        for feed in self._feeds:
            feed.notify(job_id)


async def _wait(event: asyncio.Event, seconds: float) -> bool:
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(seconds):
            await event.wait()
    return event.is_set()
