"""The dispatcher of a library with one server: it claims jobs from the durable queue, and runs them."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Collection
from functools import partial
from typing import Final

from unbend.errors import StoreError, StoreFullError, WorkerLostError
from unbend.jobs.execution import RETRY_SECONDS, Execution
from unbend.jobs.failures import describe
from unbend.jobs.limits import JobLimits
from unbend.jobs.pool import WorkerPool
from unbend.jobs.subscriptions import Subscriptions
from unbend.library import Library

logger = logging.getLogger("unbend.jobs")

_POLL_SECONDS: Final = 5.0


class Dispatcher:
    """Runs the queued jobs of a library with one server, enough at a time to keep every worker busy.

    Used within one event loop.
    """

    def __init__(
        self,
        library: Library,
        pool: WorkerPool,
        limits: JobLimits,
        execution: Execution,
        subscriptions: Subscriptions,
    ) -> None:
        self._library = library
        self._jobs = library.jobs
        self._limits = limits
        self._execution = execution
        self._subscriptions = subscriptions
        self._processes = pool.size
        # Claim twice as many jobs as there are workers, so that no worker waits for the store.
        self._slots = asyncio.Semaphore(2 * pool.size)
        self._wake = asyncio.Event()
        self._running: dict[str, asyncio.Task[None]] = {}
        self._claim_task: asyncio.Task[None] | None = None
        self._history_task: asyncio.Task[None] | None = None
        self._stop_now = asyncio.Event()
        self._loop: asyncio.AbstractEventLoop | None = None

    async def start(self) -> None:
        """Recover the jobs of an earlier server, and start to claim jobs."""
        self._loop = asyncio.get_running_loop()
        lost = describe(WorkerLostError("the process that ran the job died"))
        for job in await self._execution.retry(partial(self._jobs.recover, self._limits.restarts, lost)):
            self._execution.announce_end(job)
        self._claim_task = asyncio.create_task(self._claim_jobs(), name="unbend dispatcher")
        self._history_task = asyncio.create_task(self._execution.trim_history(), name="unbend history")

    async def stop(self) -> None:
        """Claim no more jobs, give running ones `limits.drain_seconds`, and requeue the rest.

        If the store fails, the next server requeues them.
        """
        self._execution.stop()
        for task in filter(None, (self._claim_task, self._history_task)):
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)
        await self._drain()
        remaining = list(self._running.values())
        for task in remaining:
            task.cancel()
        await asyncio.gather(*remaining, return_exceptions=True)
        with contextlib.suppress(StoreError):
            await self._execution.retry(self._jobs.requeue_all)  # includes a job whose claim was interrupted

    async def _drain(self) -> None:
        """Wait until the running jobs have ended, `limits.drain_seconds` are over, or `stop_now` is called."""
        if not self._running:
            return
        waits = [asyncio.create_task(self._stop_now.wait()), asyncio.create_task(_wait_all(self._running.values()))]
        await asyncio.wait(waits, timeout=self._limits.drain_seconds, return_when=asyncio.FIRST_COMPLETED)
        for wait in waits:
            wait.cancel()
        await asyncio.gather(*waits, return_exceptions=True)

    def stop_now(self) -> None:
        """Make `stop` wait no longer for running jobs; safe in any thread."""
        if self._loop:
            self._loop.call_soon_threadsafe(self._stop_now.set)

    @property
    def alive(self) -> bool:
        """Whether the dispatcher claims jobs."""
        return self._claim_task is not None and not self._claim_task.done()

    @property
    def running(self) -> int:
        """Number of claimed jobs."""
        return len(self._running)

    @property
    def capacity(self) -> tuple[int, int]:
        """Numbers of worker processes and of claimed jobs."""
        return self._processes, len(self._running)

    def wake(self) -> None:
        """Make the dispatcher check the queue."""
        self._wake.set()

    def kill(self, job_id: str) -> None:
        """Kill the process of a job if it is running."""
        if task := self._running.get(job_id):
            task.cancel()

    async def _claim_jobs(self) -> None:
        while True:
            await self._slots.acquire()
            self._wake.clear()
            await self._wait_for_space()
            job = await self._execution.retry(self._jobs.claim)
            if job is None:
                self._slots.release()
                await self._requeue_unknown()
                await self._wait_for_jobs()
                continue
            task = asyncio.create_task(self._execution.run(job), name=f"unbend job {job.id}")
            self._running[job.id] = task
            task.add_done_callback(partial(self._release, job.id))

    async def _wait_for_jobs(self) -> None:
        """Wait until the queue has jobs. Besides `wake`, poll the queue, because a restored backup may add jobs."""
        while not self._wake.is_set():
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(_POLL_SECONDS):
                    await self._wake.wait()
            with contextlib.suppress(StoreError):  # wait on while the store fails
                if await self._jobs.count_queued():
                    return

    async def _wait_for_space(self) -> None:
        """Wait until the disk of the library has space for a result."""
        is_logged = False
        while self._library.disk:
            try:
                self._library.disk.admit_result()
            except StoreFullError as error:
                if not is_logged:  # log only once, because the log may be on the same disk
                    logger.error("no job starts: %s", error)  # noqa: TRY400  no traceback
                is_logged = True
                await asyncio.sleep(RETRY_SECONDS)
            except StoreError:
                return  # the next write raises the error
            else:
                return

    async def _requeue_unknown(self) -> None:
        """Requeue jobs that the store marks as running but this server, the library's only one, does not run."""
        known = set(self._running)
        with contextlib.suppress(StoreError):
            for job in await self._jobs.running():
                if job.id not in known:
                    logger.warning(
                        "job %s is marked as running, but this server does not run it; it is requeued", job.id
                    )
                    await self._execution.retry(partial(self._jobs.requeue, job, "stopped"))
                    self.wake()

    def _release(self, job_id: str, _task: asyncio.Task[None]) -> None:
        self._running.pop(job_id, None)
        self._subscriptions.discard(job_id)
        self._slots.release()
        self.wake()  # an upload of the same file may have waited for this job


async def _wait_all(tasks: Collection[asyncio.Task[None]]) -> None:
    await asyncio.wait(tasks)
