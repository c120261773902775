"""News of jobs from other processes: PostgreSQL announces changes of state, and workers announce progress."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import Any, Final

from psycopg import AsyncConnection, Error, sql

from unbend.jobs.execution import RETRY_SECONDS
from unbend.jobs.subscriptions import Subscriptions
from unbend.library.storage.queue_schema import CHANNEL
from unbend.progress import Progress

logger = logging.getLogger("unbend.jobs")

_PUBLISH_SECONDS: Final = 0.25
"""Shortest time between two announcements of progress: clients get no more events either."""

_LISTEN: Final = sql.SQL("LISTEN {}").format(sql.Identifier(CHANNEL))
_PUBLISH: Final = "SELECT pg_notify(%s, payload) FROM unnest(%s::text[]) AS payload"


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
        self._unsent: dict[str, Progress] = {}
        self._has_unsent = asyncio.Event()
        self._tasks: list[asyncio.Task[None]] = []

    def start(self, changed: Callable[[str], None]) -> None:
        """Start to listen, and to publish progress; `changed` takes the id of a job that may have another state."""
        self._loop = asyncio.get_running_loop()
        self._tasks = [
            asyncio.create_task(self._listen(changed), name="unbend news"),
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
        self._unsent[job_id] = progress
        if self._loop:
            self._loop.call_soon_threadsafe(self._has_unsent.set)

    async def _listen(self, changed: Callable[[str], None]) -> None:
        while True:
            with contextlib.suppress(Error):
                async with await AsyncConnection.connect(**self._connecting, autocommit=True) as connection:
                    await connection.execute(_LISTEN)
                    self._subscriptions.notify_all()  # of whatever was announced while this process did not listen
                    async for each in connection.notifies():
                        self._hear(each.payload, changed)
            logger.warning("the connection for news of jobs was lost; trying again")
            await asyncio.sleep(RETRY_SECONDS)

    def _hear(self, payload: str, changed: Callable[[str], None]) -> None:
        heard = json.loads(payload)
        job_id = heard["job"]
        if "progress" in heard:
            self._subscriptions.report(job_id, Progress(**heard["progress"]))
            return
        if heard["state"] != "running":
            self._subscriptions.discard(job_id)
        self._subscriptions.notify_state(job_id)
        changed(job_id)

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
        return [json.dumps({"job": job_id, "progress": asdict(each)}) for job_id, each in unsent.items()]
