"""News of jobs from other processes: PostgreSQL announces changes of state, and workers announce progress."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Final

from psycopg import AsyncConnection, Error, sql

from unbend.jobs.execution import RETRY_SECONDS
from unbend.jobs.subscriptions import Subscriptions
from unbend.library.storage.queue_schema import CHANNEL
from unbend.progress import Progress

logger = logging.getLogger("unbend.jobs")

_PUBLISH_SECONDS: Final = 0.25
"""Shortest time between two announcements of progress: clients get no more events either."""

_TAKEN_AWAY: Final = frozenset({"queued", "cancelled"})
"""States that a running job gets from others than its worker."""

_LISTEN: Final = sql.SQL("LISTEN {}").format(sql.Identifier(CHANNEL))
_PUBLISH: Final = "SELECT pg_notify(%s, payload) FROM unnest(%s::text[]) AS payload"


@dataclass(frozen=True)
class WorkerNews:
    """The size and the load of a worker, which it tells with each heartbeat."""

    id: str
    processes: int
    running: int
    """Number of claimed jobs."""


class News:
    """Tells the subscribers of this process what happens in others. Used within one event loop.

    Parameters
    ----------
    connecting : mapping
        Arguments of psycopg's `connect`.
    subscriptions : Subscriptions
    """

    def __init__(self, connecting: Mapping[str, Any], subscriptions: Subscriptions) -> None:
        self._connecting = connecting
        self._subscriptions = subscriptions
        self._loop: asyncio.AbstractEventLoop | None = None
        self._unsent: dict[str, str] = {}  # payloads, by what they are about; a later one replaces an earlier one
        self._workers: dict[str, tuple[float, WorkerNews]] = {}
        self._has_unsent = asyncio.Event()
        self._tasks: list[asyncio.Task[None]] = []

    def start(self, taken: Callable[[str], None], runs: Callable[[str], bool]) -> None:
        """Start to listen, and to publish progress.

        Parameters
        ----------
        taken : callable
            Takes the id of a job that may run no longer.
        runs : callable
            Returns whether this process runs a job. It then knows more of the job's progress than late news do.
        """
        self._loop = asyncio.get_running_loop()
        self._tasks = [
            asyncio.create_task(self._listen(taken, runs), name="unbend news"),
            asyncio.create_task(self._publish(), name="unbend progress"),
        ]

    async def stop(self) -> None:
        """Stop both."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def report(self, job_id: str, progress: Progress) -> None:
        """Tell the subscribers of all processes the progress of a job; safe in any thread."""
        self._subscriptions.report(job_id, progress)
        self._send(job_id, {"job": job_id, "progress": asdict(progress)})

    def report_worker(self, worker: WorkerNews) -> None:
        """Tell all processes that a worker runs; safe in any thread."""
        self._send(worker.id, {"worker": asdict(worker)})

    def workers(self, seconds: float) -> list[WorkerNews]:
        """Return the workers that were heard of within the last `seconds`, this process's too."""
        oldest = time.monotonic() - seconds
        self._workers = {each: heard for each, heard in self._workers.items() if heard[0] >= oldest}
        return [worker for _, worker in self._workers.values()]

    def _send(self, about: str, payload: Mapping[str, Any]) -> None:
        self._unsent[about] = json.dumps(payload)
        if self._loop:
            self._loop.call_soon_threadsafe(self._has_unsent.set)

    async def _listen(self, taken: Callable[[str], None], runs: Callable[[str], bool]) -> None:
        while True:
            with contextlib.suppress(Error):
                async with await AsyncConnection.connect(**self._connecting, autocommit=True) as connection:
                    await connection.execute(_LISTEN)
                    self._subscriptions.notify_all()  # of whatever was announced while this process did not listen
                    async for each in connection.notifies():
                        self._hear(each.payload, taken, runs)
            logger.warning("the connection for news of jobs was lost; trying again")
            await asyncio.sleep(RETRY_SECONDS)

    def _hear(self, payload: str, taken: Callable[[str], None], runs: Callable[[str], bool]) -> None:
        heard = json.loads(payload)
        if "worker" in heard:
            worker = WorkerNews(**heard["worker"])
            self._workers[worker.id] = time.monotonic(), worker
            return
        job_id = heard["job"]
        if "progress" in heard:
            if not runs(job_id):
                self._subscriptions.report(job_id, Progress(**heard["progress"]))
            return
        if heard["state"] != "running" and not runs(job_id):
            self._subscriptions.discard(job_id)
        self._subscriptions.notify_state(job_id)
        if heard["state"] in _TAKEN_AWAY:
            taken(job_id)

    async def _publish(self) -> None:
        while True:
            with contextlib.suppress(Error):  # the next progress replaces the lost one
                async with await AsyncConnection.connect(**self._connecting, autocommit=True) as connection:
                    while True:
                        await self._has_unsent.wait()
                        await connection.execute(_PUBLISH, (CHANNEL, self._take()))
                        await asyncio.sleep(_PUBLISH_SECONDS)
            await asyncio.sleep(RETRY_SECONDS)

    def _take(self) -> list[str]:
        """Return what to publish, and forget it."""
        self._has_unsent.clear()
        unsent, self._unsent = self._unsent, {}
        return list(unsent.values())
