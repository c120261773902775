"""The dispatcher: claims jobs from the durable queue, computes them in worker processes, and stores the results."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import time
from collections.abc import Callable, Collection
from concurrent.futures import Future
from datetime import UTC, datetime, timedelta
from functools import partial
from typing import Final, TypeVar

from unbend.errors import NotFoundError, StoreError, StoreFullError, WorkerLostError
from unbend.jobs.failures import describe, typed_error
from unbend.jobs.limits import JobLimits
from unbend.jobs.observer import CURRENT_JOB, JobObserver
from unbend.jobs.pool import WorkerPool
from unbend.jobs.subscriptions import Subscriptions
from unbend.jobs.worker import StoredMesh, compute_query, compute_shape, make_file
from unbend.library import Library
from unbend.library.records import JobFile, JobRecord
from unbend.library.requests import FileRequest, QueryRequest, UploadKey
from unbend.signature.signature import Signature

logger = logging.getLogger("unbend.jobs")
T = TypeVar("T")

_RETRY_SECONDS: Final = 1.0
_POLL_SECONDS: Final = 5.0
_FILES_KEPT: Final = timedelta(days=1)
_HISTORY_SECONDS: Final = 60.0
_SIGNATURES_KEPT: Final = 32
_STOPPING_SECONDS: Final = 3.0
"""Time for which a stopping server retries a failing store. The next server recovers jobs whose end was not written."""


class Dispatcher:
    """Runs queued jobs, enough at a time to keep every worker busy. Used within one event loop."""

    def __init__(
        self,
        library: Library,
        pool: WorkerPool,
        limits: JobLimits,
        observer: JobObserver,
        subscriptions: Subscriptions,
        *,
        with_parts: bool,
    ) -> None:
        self._library = library
        self._jobs = library.jobs
        self._pool = pool
        self._limits = limits
        self._observer = observer
        self._subscriptions = subscriptions
        self._with_parts = with_parts
        # Claim twice as many jobs as there are workers, so that no worker waits for the store.
        self._slots = asyncio.Semaphore(2 * pool.size)
        self._wake = asyncio.Event()
        self._running: dict[str, asyncio.Task[None]] = {}
        self._signatures: dict[UploadKey, Signature] = {}  # of recent queries, the latest last
        self._claim_task: asyncio.Task[None] | None = None
        self._history_task: asyncio.Task[None] | None = None
        self._is_stopping = False
        self._stop_now = asyncio.Event()
        self._loop: asyncio.AbstractEventLoop | None = None

    async def start(self) -> None:
        """Recover the jobs of an earlier server, and start to claim jobs."""
        self._loop = asyncio.get_running_loop()
        lost = describe(WorkerLostError("the process that ran the job died"))
        for job in await self._retry(partial(self._jobs.recover, self._limits.restarts, lost)):
            self.announce_end(job)
        self._claim_task = asyncio.create_task(self._claim_jobs(), name="unbend dispatcher")
        self._history_task = asyncio.create_task(self._trim_history(), name="unbend history")

    async def stop(self) -> None:
        """Claim no more jobs, give running ones `limits.drain_seconds`, and requeue the rest.

        If the store fails, the next server requeues them.
        """
        self._is_stopping = True
        for task in filter(None, (self._claim_task, self._history_task)):
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)
        await self._drain()
        remaining = list(self._running.values())
        for task in remaining:
            task.cancel()
        await asyncio.gather(*remaining, return_exceptions=True)
        with contextlib.suppress(StoreError):
            await self._retry(self._jobs.requeue_all)  # includes a job whose claim was interrupted

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

    def wake(self) -> None:
        """Make the dispatcher check the queue."""
        self._wake.set()

    def kill(self, job_id: str) -> None:
        """Kill the process of a job if it is running."""
        if task := self._running.get(job_id):
            task.cancel()

    def announce_end(self, job: JobRecord) -> None:
        """Log the end of a job, and notify the observer and the subscribers."""
        if job.error:
            logger.info("%s job %s: %s: %s", job.kind, job.state, job.error["code"], job.error["message"])
        else:
            logger.info("%s job %s", job.kind, job.state)
        self._observer.ended(job)
        self._subscriptions.notify_state(job.id)

    async def delete_ended(
        self, *, before: datetime | None = None, keep: int | None = None, owner: str | None = None
    ) -> int:
        """Delete ended jobs in batches, as `Jobs.delete_ended` does; return their number."""
        count = 0
        while batch := await asyncio.wrap_future(self._jobs.delete_ended(before=before, keep=keep, owner=owner)):
            count += batch
        return count

    async def _trim_history(self) -> None:
        """Delete ended jobs beyond the limits, and old files of jobs, every minute."""
        while True:
            with contextlib.suppress(StoreError):  # retried after a minute
                await self.delete_ended(keep=self._limits.history)
                await asyncio.wrap_future(self._jobs.delete_files(datetime.now(UTC) - _FILES_KEPT))
                if self._limits.history_days:
                    await self.delete_ended(before=datetime.now(UTC) - timedelta(days=self._limits.history_days))
            await asyncio.sleep(_HISTORY_SECONDS)

    async def _claim_jobs(self) -> None:
        while True:
            await self._slots.acquire()
            self._wake.clear()
            await self._wait_for_space()
            job = await self._retry(self._jobs.claim)
            if job is None:
                self._slots.release()
                await self._requeue_unknown()
                await self._wait_for_jobs()
                continue
            task = asyncio.create_task(self._run(job), name=f"unbend job {job.id}")
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
                await asyncio.sleep(_RETRY_SECONDS)
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
                    await self._retry(partial(self._jobs.requeue, job, "stopped"))
                    self.wake()

    def _release(self, job_id: str, _task: asyncio.Task[None]) -> None:
        self._running.pop(job_id, None)
        self._subscriptions.discard(job_id)
        self._slots.release()
        self.wake()  # an upload of the same file may have waited for this job

    async def _run(self, job: JobRecord) -> None:
        CURRENT_JOB.set(job.id)
        logger.info("%s job started, attempt %d", job.kind, job.attempts)
        self._observer.begun(job)
        self._subscriptions.notify_state(job.id)
        try:
            ended = await self._complete(job)
        except WorkerLostError as error:
            if job.attempts < self._limits.attempts:
                logger.warning("the job lost its process, attempt %d", job.attempts)
                await self._retry(partial(self._jobs.requeue, job, "worker lost"))
                self._subscriptions.notify_state(job.id)
                self.wake()
                return
            ended = await self._fail(job, error)
        except Exception as error:  # noqa: BLE001  any error fails this job only
            ended = await self._fail(job, error)
        if ended:
            self.announce_end(ended)

    async def _complete(self, job: JobRecord) -> JobRecord | None:
        """Compute a job and store its result; None if the job was cancelled or requeued meanwhile."""
        mesh = StoredMesh(self._library.url, job.mesh_sha256 or "", job.file_type, job.policy, self._limits.mesh)
        match job.request:
            case QueryRequest():
                return await self._complete_query(job, mesh, job.request)
            case FileRequest():
                data = await self._compute(job, make_file, mesh, job.request)
                file = JobFile(job.request.file_type, job.request.name, data)
                return await self._retry(partial(self._jobs.complete_file, job, file))
            case _:
                return await self._complete_shape(job, mesh)

    async def _complete_shape(self, job: JobRecord, mesh: StoredMesh) -> JobRecord | None:
        key = UploadKey.of(mesh.sha256, job.parameters, job.policy)
        if await self._jobs.is_known(key):  # an equal job has stored the shape
            return await self._retry(partial(self._jobs.complete_known, job, key))
        outcome = await self._compute(job, compute_shape, mesh, job.parameters, self._with_parts)
        self._observer.computed(outcome.seconds)
        return await self._retry(partial(self._jobs.complete_shape, job, outcome.shape))

    async def _complete_query(self, job: JobRecord, mesh: StoredMesh, request: QueryRequest) -> JobRecord | None:
        key, local = UploadKey.of(mesh.sha256, job.parameters, job.policy), request.part_measure is not None
        signature = self._signatures.pop(key, None)  # the same file may be ranked by another measure
        if signature is None or (local and signature.local is None):
            outcome = await self._compute(job, compute_query, mesh, job.parameters, local)
            self._observer.computed(outcome.seconds)
            signature = outcome.signature
        self._signatures[key] = signature
        if len(self._signatures) > _SIGNATURES_KEPT:
            del self._signatures[next(iter(self._signatures))]
        ranking = await asyncio.to_thread(self._library.search.rank, signature, request)
        return await self._retry(partial(self._jobs.complete_query, job, ranking))

    async def _compute(self, job: JobRecord, function: Callable[..., T], *arguments: object) -> T:
        report = partial(self._subscriptions.report, job.id)
        return await self._pool.call(function, arguments, self._limits.seconds, report)

    async def _fail(self, job: JobRecord, error: Exception) -> JobRecord | None:
        described, reached = describe(typed_error(error)), self._subscriptions.progress(job.id)
        return await self._retry(partial(self._jobs.fail, job, described, reached))

    async def _retry(self, write: Callable[[], Future[T]]) -> T:
        """Retry a write while the store fails, so that no claim and no result is lost; a stopping server gives up."""
        deadline = math.inf
        while True:
            try:
                return await asyncio.wrap_future(write())
            except StoreError as error:
                if self._is_stopping:
                    deadline = min(deadline, time.monotonic() + _STOPPING_SECONDS)
                if isinstance(error, NotFoundError) or time.monotonic() >= deadline:
                    raise
                logger.exception("the store cannot be written; trying again")
                await asyncio.sleep(_RETRY_SECONDS)


async def _wait_all(tasks: Collection[asyncio.Task[None]]) -> None:
    await asyncio.wait(tasks)
