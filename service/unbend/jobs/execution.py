"""The execution of a claimed job: compute it in a worker process, and store the result."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import time
from collections.abc import Callable
from concurrent.futures import Future
from datetime import UTC, datetime, timedelta
from functools import partial
from typing import Final, TypeVar

from unbend.errors import (
    NotFoundError,
    ObjectMissingError,
    ObjectsUnavailableError,
    StoreError,
    StoreUnavailableError,
    WorkerLostError,
)
from unbend.jobs.failures import describe, typed_error
from unbend.jobs.limits import JobLimits
from unbend.jobs.observer import CURRENT_JOB, JobObserver
from unbend.jobs.pool import WorkerPool
from unbend.jobs.subscriptions import Subscriptions
from unbend.jobs.worker import StoredMesh, compute_query, compute_shape, make_file
from unbend.library import Library
from unbend.library.job_rows import Cause
from unbend.library.records import JobFile, JobRecord
from unbend.library.requests import FileRequest, QueryRequest, UploadKey
from unbend.progress import Progress
from unbend.signature.signature import Signature

logger = logging.getLogger("unbend.jobs")
T = TypeVar("T")

RETRY_SECONDS: Final = 1.0
"""Time between two attempts to use a store that fails."""

_FILES_KEPT: Final = timedelta(days=1)
_HISTORY_SECONDS: Final = 60.0
_SIGNATURES_KEPT: Final = 32
_STOPPING_SECONDS: Final = 3.0
"""Time for which a stopping server retries a failing store. The next server recovers jobs whose end was not written."""


class Execution:
    """Runs claimed jobs. Used within one event loop.

    Parameters
    ----------
    library : Library
    pool : WorkerPool
    limits : JobLimits
    observer : JobObserver
    subscriptions : Subscriptions
    report : callable
        Takes the id of a job and its progress, in any thread.
    with_parts : bool
        Whether the signatures of uploads get local signatures.
    """

    def __init__(
        self,
        library: Library,
        pool: WorkerPool,
        limits: JobLimits,
        observer: JobObserver,
        subscriptions: Subscriptions,
        report: Callable[[str, Progress], None],
        *,
        with_parts: bool,
    ) -> None:
        self._library = library
        self._jobs = library.jobs
        self._pool = pool
        self._limits = limits
        self._observer = observer
        self._subscriptions = subscriptions
        self._report = report
        self._with_parts = with_parts
        self._signatures: dict[UploadKey, Signature] = {}  # of recent queries, the latest last
        self._is_stopping = False

    def stop(self) -> None:
        """Retry a failing store only for some seconds from now on."""
        self._is_stopping = True

    async def run(self, job: JobRecord) -> None:
        """Compute a claimed job, and store its result; return it to the queue if its process or the store failed."""
        CURRENT_JOB.set(job.id)
        logger.info("%s job started, attempt %d", job.kind, job.attempts)
        self._observer.begun(job)
        self._subscriptions.notify_state(job.id)
        try:
            ended = await self._complete(job)
        except WorkerLostError as error:
            if job.attempts < self._limits.attempts:
                logger.warning("the job lost its process, attempt %d", job.attempts)
                await self.retry(partial(self._jobs.requeue, job, "process lost"))
                self._subscriptions.notify_state(job.id)
                return
            ended = await self._fail(job, error)
        except StoreUnavailableError as error:
            waits = isinstance(error, ObjectsUnavailableError) and not isinstance(error, ObjectMissingError)
            if waits or job.restarts < self._limits.restarts:
                logger.warning("the job returns to the queue: %s", error)
                await asyncio.sleep(RETRY_SECONDS)
                cause: Cause = "objects unavailable" if waits else "server lost"
                await self.retry(partial(self._jobs.requeue, job, cause))
                return
            ended = await self._fail(job, error)
        except Exception as error:  # noqa: BLE001  any error fails this job only
            ended = await self._fail(job, error)
        if ended:
            self.announce_end(ended)

    def announce_end(self, job: JobRecord) -> None:
        """Log the end of a job, and notify the observer and the subscribers."""
        if job.error:
            logger.info("%s job %s: %s: %s", job.kind, job.state, job.error["code"], job.error["message"])
        else:
            logger.info("%s job %s", job.kind, job.state)
        self._observer.ended(job)
        self._subscriptions.notify_state(job.id)

    async def _complete(self, job: JobRecord) -> JobRecord | None:
        """Compute a job and store its result; None if the job was cancelled or requeued meanwhile."""
        mesh = StoredMesh(self._library.address, job.mesh_sha256 or "", job.file_type, job.policy, self._limits.mesh)
        match job.request:
            case QueryRequest():
                return await self._complete_query(job, mesh, job.request)
            case FileRequest():
                data = await self._compute(job, make_file, mesh, job.request)
                file = JobFile(job.request.file_type, job.request.name, data)
                return await self.retry(partial(self._jobs.complete_file, job, file))
            case _:
                return await self._complete_shape(job, mesh)

    async def _complete_shape(self, job: JobRecord, mesh: StoredMesh) -> JobRecord | None:
        key = UploadKey.of(mesh.sha256, job.parameters, job.policy)
        if await self._jobs.is_known(key):  # an equal job has stored the shape
            return await self.retry(partial(self._jobs.complete_known, job, key))
        outcome = await self._compute(job, compute_shape, mesh, job.parameters, self._with_parts)
        self._observer.computed(outcome.seconds)
        return await self.retry(partial(self._jobs.complete_shape, job, outcome.shape))

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
        return await self.retry(partial(self._jobs.complete_query, job, ranking))

    async def _compute(self, job: JobRecord, function: Callable[..., T], *arguments: object) -> T:
        report = partial(self._report, job.id)
        return await self._pool.call(function, arguments, self._limits.seconds, report)

    async def _fail(self, job: JobRecord, error: Exception) -> JobRecord | None:
        described, reached = describe(typed_error(error)), self._subscriptions.progress(job.id)
        return await self.retry(partial(self._jobs.fail, job, described, reached))

    async def delete_ended(
        self, *, before: datetime | None = None, keep: int | None = None, owner: str | None = None
    ) -> int:
        """Delete ended jobs in batches, as `Jobs.delete_ended` does; return their number."""
        count = 0
        while batch := await asyncio.wrap_future(self._jobs.delete_ended(before=before, keep=keep, owner=owner)):
            count += batch
        return count

    async def trim_history(self) -> None:
        """Delete ended jobs beyond the limits, and old files of jobs, every minute; runs until it is cancelled."""
        while True:
            with contextlib.suppress(StoreError):  # retried after a minute
                await self.delete_ended(keep=self._limits.history)
                await asyncio.wrap_future(self._jobs.delete_files(datetime.now(UTC) - _FILES_KEPT))
                if self._limits.history_days:
                    await self.delete_ended(before=datetime.now(UTC) - timedelta(days=self._limits.history_days))
            await asyncio.sleep(_HISTORY_SECONDS)

    async def retry(self, write: Callable[[], Future[T]]) -> T:
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
                await asyncio.sleep(RETRY_SECONDS)
