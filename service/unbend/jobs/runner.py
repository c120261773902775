"""The dispatcher: takes jobs from the durable queue, has processes compute them, stores what comes back."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import logging
import tempfile
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from pebble import ProcessExpired

from unbend.errors import JobCancelledError, NotFoundError, QueueFullError
from unbend.jobs.failures import describe, typed_error
from unbend.jobs.observer import CURRENT_JOB, JobObserver, NoObserver
from unbend.jobs.pool import WorkerPool
from unbend.jobs.progress import ProgressFile, Report
from unbend.jobs.worker import Outcome, StoredMesh, Task, compute
from unbend.library import Library, queue
from unbend.library import shapes as rows
from unbend.library.key import UploadKey
from unbend.library.records import JobKind, JobRecord, JobState, ShapeRecord
from unbend.mesh.policy import MeshPolicy
from unbend.signature.parameters import Parameters

logger = logging.getLogger("unbend.jobs")
T = TypeVar("T")

_RETRY_SECONDS = 1.0
_LOOK_SECONDS = 0.25  # between two looks at a job that somebody follows


@dataclass(frozen=True)
class JobLimits:
    """What one job, and the queue, may take."""

    seconds: float = 600.0
    memory_mb: int | None = 8192
    queued: int = 10_000
    attempts: int = 2
    """Times a job is begun before the loss of its process is its failure."""
    restarts: int = 10
    """Times the whole server may be lost while a job is in hand: seldom that job's fault, but it may be."""
    drain_seconds: float = 20.0


@dataclass(frozen=True)
class Upload:
    """A file to compute: its bytes, its name's extension where the content does not tell the format, how to read it."""

    data: bytes
    file_type: str
    parameters: Parameters
    policy: MeshPolicy


class JobRunner:
    """Runs a library's jobs; made and used within one event loop.

    A job is durable when `submit` returns it. Jobs found running at `start` were cut off by the end of an
    earlier process: they are run again, up to `limits.restarts` times.
    """

    def __init__(
        self,
        library: Library,
        *,
        workers: int,
        limits: JobLimits | None = None,
        observer: JobObserver | None = None,
    ) -> None:
        self.workers = workers
        self.limits = limits or JobLimits()
        self._library = library
        self._observer: JobObserver = observer or NoObserver()
        self._pool = WorkerPool(workers, self.limits.memory_mb)
        # twice as many jobs as processes are in hand, so that no process waits for the store
        self._slots = asyncio.Semaphore(2 * workers)
        self._wake = asyncio.Event()
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self._finished: dict[str, asyncio.Event] = {}
        self._folder = tempfile.TemporaryDirectory(prefix="unbend-")
        self._dispatcher: asyncio.Task[None] | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._stopping = False
        self._warming: asyncio.Task[None] | None = None

    async def start(self) -> None:
        """Take up what an earlier process left, begin, and warm the workers meanwhile."""
        self._loop = asyncio.get_running_loop()
        await asyncio.to_thread(self._recover)
        self._warming = asyncio.create_task(self._pool.warm_up(), name="unbend warm-up")
        self._dispatcher = asyncio.create_task(self._dispatch(), name="unbend dispatcher")

    async def stop(self) -> None:
        """Stop claiming, give running jobs `limits.drain_seconds`, put the rest back into the queue."""
        self._end_waits()
        own = [task for task in (self._dispatcher, self._warming) if task]
        for task in own:
            task.cancel()
        await asyncio.gather(*own, return_exceptions=True)
        if self._tasks:
            await asyncio.wait(self._tasks.values(), timeout=self.limits.drain_seconds)
        left = dict(self._tasks)
        for task in left.values():
            task.cancel()
        await asyncio.gather(*left.values(), return_exceptions=True)
        for job_id in left:
            await asyncio.to_thread(self._give_back, job_id, "nothing")
        await asyncio.to_thread(self._pool.stop)
        self._folder.cleanup()

    def end_waits(self) -> None:
        """Answer everybody who waits for a job with the job as it is; safe to call from a signal handler."""
        if self._loop:
            self._loop.call_soon_threadsafe(self._end_waits)

    def _end_waits(self) -> None:
        self._stopping = True
        for event in self._finished.values():
            event.set()

    @property
    def alive(self) -> bool:
        """Whether the dispatcher runs, and workers could be started."""
        warming = self._warming
        failed = warming is not None and warming.done() and (warming.cancelled() or warming.exception() is not None)
        return self._dispatcher is not None and not self._dispatcher.done() and not failed

    @property
    def ready(self) -> bool:
        """Whether the workers have their kernels loaded."""
        return self.alive and self._warming is not None and self._warming.done()

    @property
    def running(self) -> int:
        """How many jobs are in hand."""
        return len(self._tasks)

    async def submit(self, kind: JobKind, upload: Upload, request: dict[str, Any]) -> JobRecord | ShapeRecord:
        """Queue a computation, durably; or return the stored shape, or the job under way, that is the same.

        Raises
        ------
        QueueFullError
            If `limits.queued` jobs wait already.
        """
        answer = await asyncio.to_thread(self._enqueue, kind, upload, request)
        if isinstance(answer, JobRecord):
            CURRENT_JOB.set(answer.id)
        self._wake.set()
        return answer

    async def status(self, job_id: str) -> JobRecord:
        """Return a job with its live progress; NotFoundError if there is none."""
        return await asyncio.to_thread(self._status, job_id)

    async def newest(self, *, state: JobState | None, limit: int) -> list[JobRecord]:
        """Return the newest jobs, of one state if given."""
        return await asyncio.to_thread(self._newest, state, limit)

    async def queued(self) -> int:
        """Return how many jobs wait."""
        return await asyncio.to_thread(self._position, None)

    async def position(self, job: JobRecord) -> int | None:
        """Return how many jobs wait before a queued one."""
        return None if job.state != "queued" else await asyncio.to_thread(self._position, job.seq)

    async def wait(self, job_id: str, seconds: float) -> JobRecord:
        """Return a job when it has ended, or as it is after `seconds`."""
        await self.status(job_id)
        if self._stopping:
            return await self.status(job_id)
        event = self._finished.setdefault(job_id, asyncio.Event())
        job = await self.status(job_id)  # again: it may have ended before the event was there
        if job.finished:
            self._announce(job_id)
            return job
        await _until_set(event, seconds)
        return await self.status(job_id)

    async def follow(self, job_id: str) -> AsyncIterator[JobRecord]:
        """Yield a job as it is, some times a second, and at once when it ends.

        The last is the ended job, or, where the server stops, the job as it is then.

        Raises
        ------
        NotFoundError
            If there is no such job.
        """
        while True:
            event = self._finished.setdefault(job_id, asyncio.Event())  # before looking: an end is not missed
            stopping = self._stopping
            try:
                job = await self.status(job_id)
            except NotFoundError:
                self._announce(job_id)
                raise
            if job.finished:
                self._announce(job_id)
            yield job
            if job.finished or stopping:
                return
            await _until_set(event, _LOOK_SECONDS)

    async def call(self, function: Callable[..., T], *arguments: object) -> T:
        """Run a function on stored data in a worker process, past the queue, under the limits of a job.

        Raises
        ------
        UnbendError
            As the function does, or as a job would fail.
        """
        try:
            return await self._pool.call(function, arguments, self.limits.seconds)
        except Exception as error:
            raise typed_error(error, self.limits.seconds) from error

    async def cancel(self, job_id: str) -> JobRecord:
        """Cancel a job: a queued one is never run, a running one's process is stopped; an ended one stays."""
        error = describe(JobCancelledError("the job was cancelled"))
        CURRENT_JOB.set(job_id)
        if await asyncio.to_thread(self._finish, job_id, "cancelled", error=error):
            if task := self._tasks.get(job_id):
                task.cancel()
            self._announce(job_id)
        return await self.status(job_id)

    # The dispatcher's own steps

    async def _dispatch(self) -> None:
        while True:
            await self._slots.acquire()
            self._wake.clear()
            try:
                job = await asyncio.to_thread(self._claim)
            except Exception:
                logger.exception("the queue cannot be read; trying again")
                self._slots.release()
                await asyncio.sleep(_RETRY_SECONDS)
                continue
            if job is None:
                self._slots.release()
                await self._wake.wait()
                continue
            task = asyncio.create_task(self._run(job), name=f"unbend job {job.id}")
            self._tasks[job.id] = task
            task.add_done_callback(partial(self._release, job.id))

    def _release(self, job_id: str, _task: asyncio.Task[None]) -> None:
        self._tasks.pop(job_id, None)
        self._slots.release()
        ProgressFile(self._progress_folder, job_id).remove()

    async def _run(self, job: JobRecord) -> None:
        CURRENT_JOB.set(job.id)
        logger.info("%s job begun, attempt %d", job.kind, job.attempts)
        self._observer.begun(job)
        try:
            outcome = await self._pool.call(compute, (self._task(job),), self.limits.seconds)
            self._observer.computed(outcome.seconds)
            await asyncio.to_thread(self._store, job, outcome)
        except ProcessExpired as error:
            if job.attempts < self.limits.attempts:
                logger.warning("the job lost its process, attempt %d", job.attempts)
                await asyncio.to_thread(self._give_back, job.id, "worker")
                self._wake.set()
                return
            await self._fail(job, error)
        except Exception as error:  # noqa: BLE001  whatever a job does, it ends as that job's failure
            await self._fail(job, error)
        self._announce(job.id)

    def _task(self, job: JobRecord) -> Task:
        policy = MeshPolicy.from_json(job.policy)
        mesh = StoredMesh(self._library.store.url, job.mesh_sha256 or "", job.file_type, policy)
        return Task(job.id, mesh, self._progress_folder, job.parameters)

    async def _fail(self, job: JobRecord, error: Exception) -> None:
        typed = typed_error(error, self.limits.seconds)
        report = ProgressFile(self._progress_folder, job.id).read() or Report(job.stage, job.progress)
        reached = {"stage": report.stage, "progress": report.share}
        await asyncio.to_thread(self._finish, job.id, "failed", error=describe(typed), reached=reached)

    def _announce(self, job_id: str) -> None:
        if event := self._finished.pop(job_id, None):
            event.set()

    # What is done on the store, in threads

    @property
    def _progress_folder(self) -> Path:
        return Path(self._folder.name)

    def _enqueue(self, kind: JobKind, upload: Upload, request: dict[str, Any]) -> JobRecord | ShapeRecord:
        key = UploadKey.of(upload.data, upload.parameters, upload.policy)
        with self._library.store.write() as connection:
            if kind == "shape":
                if shape := rows.find_shape(connection, key):
                    return shape
                if job := queue.find_active(connection, kind=kind, key=key):
                    return job
            waiting = queue.count_queued(connection)
            if waiting >= self.limits.queued:
                raise QueueFullError(f"{waiting} jobs wait already", retry_after=max(1, waiting // (50 * self.workers)))
            rows.put_mesh(connection, key.sha256, upload.data)
            job = queue.enqueue(connection, kind=kind, key=key, file_type=upload.file_type, request=request)
            self._observer.submitted(job)
            return job

    def _claim(self) -> JobRecord | None:
        with self._library.store.write() as connection:
            return queue.claim(connection)

    def _store(self, job: JobRecord, outcome: Outcome) -> None:
        if job.kind == "query":
            ranking = self._library.rank(outcome.signature, **job.request)
            self._finish(job.id, "succeeded", result=ranking.as_dict())
            return
        new = rows.NewShape(
            sha256=job.mesh_sha256 or "", policy=MeshPolicy.from_json(job.policy), signature=outcome.signature,
            area=outcome.area, report=outcome.report, name=job.request["name"], label=job.request["label"],
            metadata=job.request["metadata"],
        )  # fmt: skip
        with self._library.store.write() as connection:
            if queue.get_job(connection, job.id).finished:  # cancelled while the result was on its way
                return
            shape = rows.add_shape(connection, new)
            queue.finish(connection, job.id, "succeeded", shape_id=shape.id)
            ended = queue.get_job(connection, job.id)
        self._note_end(ended)

    def _finish(self, job_id: str, state: JobState, **values: Any) -> bool:
        with self._library.store.write() as connection:
            changed = queue.finish(connection, job_id, state, **values)
            job = queue.get_job(connection, job_id) if changed else None
        if job:
            self._note_end(job)
        return changed

    def _note_end(self, job: JobRecord) -> None:
        if job.error:
            logger.info("%s job %s: %s: %s", job.kind, job.state, job.error["code"], job.error["message"])
        else:
            logger.info("%s job %s", job.kind, job.state)
        self._observer.ended(job)

    def _give_back(self, job_id: str, lost: queue.Lost) -> None:
        with self._library.store.write() as connection:
            queue.give_back(connection, job_id, lost=lost)

    def _recover(self) -> None:
        lost = typed_error(ProcessExpired("", 0, 0), self.limits.seconds)
        ended = []
        with self._library.store.write() as connection:
            for job in queue.running_jobs(connection):
                if job.restarts < self.limits.restarts:
                    queue.give_back(connection, job.id, lost="server")
                else:
                    queue.finish(connection, job.id, "failed", error=describe(lost))
                    ended.append(queue.get_job(connection, job.id))
        for job in ended:
            self._note_end(job)

    def _status(self, job_id: str) -> JobRecord:
        with self._library.store.read() as connection:
            return self._live(queue.get_job(connection, job_id))

    def _live(self, job: JobRecord) -> JobRecord:
        live = ProgressFile(self._progress_folder, job.id).read() if job.state == "running" else None
        return job if live is None else dataclasses.replace(job, stage=live.stage, progress=live.share)

    def _newest(self, state: JobState | None, limit: int) -> list[JobRecord]:
        with self._library.store.read() as connection:
            return [self._live(job) for job in queue.list_jobs(connection, state=state, limit=limit)]

    def _position(self, seq: int | None) -> int:
        with self._library.store.read() as connection:
            return queue.count_queued(connection, before=seq)


async def _until_set(event: asyncio.Event, seconds: float) -> None:
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(seconds):
            await event.wait()
