"""The dispatcher: takes jobs from the durable queue, has processes compute them, stores what comes back."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import time
from collections.abc import Callable, Collection, Mapping
from datetime import UTC, datetime, timedelta
from functools import partial
from typing import Any, Final, TypeVar

from sqlalchemy import Connection

from unbend.errors import NotFoundError, StoreError, StoreFullError, WorkerLostError
from unbend.jobs.failures import describe, typed_error
from unbend.jobs.limits import JobLimits
from unbend.jobs.news import News
from unbend.jobs.observer import CURRENT_JOB, JobObserver
from unbend.jobs.pool import WorkerPool
from unbend.jobs.progress import Report
from unbend.jobs.worker import FileTask, Outcome, StoredMesh, Task, compute, make_file
from unbend.library import Library, queue
from unbend.library import shapes as rows
from unbend.library.key import UploadKey
from unbend.library.records import JobFile, JobRecord
from unbend.library.writer import Writer
from unbend.mesh.policy import MeshPolicy

logger = logging.getLogger("unbend.jobs")
T = TypeVar("T")

_RETRY_SECONDS: Final = 1.0
_LOOK_SECONDS: Final = 5.0
_FILES_KEPT: Final = timedelta(days=1)
_HISTORY_SECONDS: Final = 60.0
_LAST_SECONDS: Final = 3.0
"""How long a server that stops tries to write to a store that fails. The next server finds what was not written."""

_LOST: Final = WorkerLostError("the process that ran the job died")


class Dispatcher:
    """Runs queued jobs, as many at a time as keep the processes busy. Used within one event loop."""

    def __init__(
        self, library: Library, writer: Writer, pool: WorkerPool, limits: JobLimits, observer: JobObserver, news: News
    ) -> None:
        self._library = library
        self._writer = writer
        self._pool = pool
        self._limits = limits
        self._observer = observer
        self._news = news
        # twice as many jobs as processes are in hand, so that no process waits for the store
        self._slots = asyncio.Semaphore(2 * pool.size)
        self._wake = asyncio.Event()
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self._loop_task: asyncio.Task[None] | None = None
        self._history_task: asyncio.Task[None] | None = None
        self._is_stopping = False
        self._hurry = asyncio.Event()
        self._loop: asyncio.AbstractEventLoop | None = None

    async def start(self) -> None:
        """Take up what an earlier process left, and begin."""
        self._loop = asyncio.get_running_loop()
        for job in await self._made(self._recover):
            self.note_end(job)
        self._loop_task = asyncio.create_task(self._dispatch(), name="unbend dispatcher")
        self._history_task = asyncio.create_task(self._bound_history(), name="unbend history")

    async def stop(self) -> None:
        """Claim no more, give running jobs `limits.drain_seconds`, put the rest back into the queue.

        Where the store cannot be written, the rest stays as it is: the next server puts it back.
        """
        self._is_stopping = True
        for task in filter(None, (self._loop_task, self._history_task)):
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)
        await self._drain()
        left = list(self._tasks.values())
        for task in left:
            task.cancel()
        await asyncio.gather(*left, return_exceptions=True)
        with contextlib.suppress(StoreError):
            await self._made(_give_all_back)  # also one whose claim was under way

    async def _drain(self) -> None:
        """Wait until the jobs in hand have ended, their time is over, or somebody is in a hurry."""
        if not self._tasks:
            return
        waits = [asyncio.create_task(self._hurry.wait()), asyncio.create_task(_all_ended(self._tasks.values()))]
        await asyncio.wait(waits, timeout=self._limits.drain_seconds, return_when=asyncio.FIRST_COMPLETED)
        for wait in waits:
            wait.cancel()
        await asyncio.gather(*waits, return_exceptions=True)

    def hurry(self) -> None:
        """Give running jobs no more time where they are being waited for; safe in any thread."""
        if self._loop:
            self._loop.call_soon_threadsafe(self._hurry.set)

    @property
    def alive(self) -> bool:
        """Whether jobs are taken from the queue."""
        return self._loop_task is not None and not self._loop_task.done()

    @property
    def running(self) -> int:
        """How many jobs are in hand."""
        return len(self._tasks)

    def wake(self) -> None:
        """Have the queue looked at."""
        self._wake.set()

    def drop(self, job_id: str) -> None:
        """Stop a job's process if it is in hand."""
        if task := self._tasks.get(job_id):
            task.cancel()

    def note_end(self, job: JobRecord) -> None:
        """Tell the log, the observer, and whoever waits, of a job that has ended."""
        if job.error:
            logger.info("%s job %s: %s: %s", job.kind, job.state, job.error["code"], job.error["message"])
        else:
            logger.info("%s job %s", job.kind, job.state)
        self._observer.ended(job)
        self._news.change(job.id)

    async def forget(self, *, before: datetime | None = None, keep: int | None = None, owner: str | None = None) -> int:
        """Forget jobs that have ended, some at a time, as `queue.forget_ended` has it; return how many."""
        count = 0
        while some := await asyncio.wrap_future(
            self._writer.submit(partial(queue.forget_ended, before=before, keep=keep, owner=owner))
        ):
            count += some
        return count

    async def _bound_history(self) -> None:
        """Forget jobs beyond the limits, from time to time."""
        while True:
            with contextlib.suppress(StoreError):  # the next time it may be written
                await self.forget(keep=self._limits.history)
                await self._made(partial(queue.forget_files, before=datetime.now(UTC) - _FILES_KEPT))
                if self._limits.history_days:
                    await self.forget(before=datetime.now(UTC) - timedelta(days=self._limits.history_days))
            await asyncio.sleep(_HISTORY_SECONDS)

    async def _dispatch(self) -> None:
        while True:
            await self._slots.acquire()
            self._wake.clear()
            await self._room()
            job = await self._made(queue.claim)
            if job is None:
                self._slots.release()
                await self._reconcile()
                await self._work()
                continue
            task = asyncio.create_task(self._run(job), name=f"unbend job {job.id}")
            self._tasks[job.id] = task
            task.add_done_callback(partial(self._release, job.id))

    async def _work(self) -> None:
        """Wait until there may be a job: others than this process can put some there, such as a restored backup."""
        while not self._wake.is_set():
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(_LOOK_SECONDS):
                    await self._wake.wait()
            with contextlib.suppress(StoreError):  # then it is no time to begin one
                if await self._library.store.fetch(queue.count_queued):
                    return

    async def _room(self) -> None:
        """Wait until the disk of the library has room for a result."""
        told = False
        while True:
            try:
                self._library.store.admit_result()
            except StoreFullError as error:
                if not told:  # once: the log may be on the same disk
                    logger.error("no job is begun: %s", error)  # noqa: TRY400  no stack is needed to read it
                told = True
                await asyncio.sleep(_RETRY_SECONDS)
            except StoreError:
                return  # whoever writes next finds out
            else:
                return

    async def _reconcile(self) -> None:
        """Put back jobs that the store has as running and nobody has in hand: this server alone runs its jobs."""
        in_hand = set(self._tasks)
        with contextlib.suppress(StoreError):
            for job in await self._library.store.fetch(queue.running_jobs):
                if job.id not in in_hand:
                    logger.warning("job %s is running in the store but not here; it is put back", job.id)
                    await self._give_back(job.id)
                    self.wake()

    async def _give_back(self, job_id: str) -> None:
        await self._made(partial(queue.give_back, job_id=job_id, lost="nothing"))

    def _release(self, job_id: str, _task: asyncio.Task[None]) -> None:
        self._tasks.pop(job_id, None)
        self._news.forget(job_id)
        self._slots.release()
        self.wake()  # an upload of the same file may have waited for this one

    async def _run(self, job: JobRecord) -> None:
        CURRENT_JOB.set(job.id)
        logger.info("%s job begun, attempt %d", job.kind, job.attempts)
        self._observer.begun(job)
        self._news.change(job.id)
        try:
            ended = await self._computed(job)
        except WorkerLostError as error:
            if job.attempts < self._limits.attempts:
                logger.warning("the job lost its process, attempt %d", job.attempts)
                await self._made(partial(queue.give_back, job_id=job.id, lost="worker"))
                self._news.change(job.id)
                self.wake()
                return
            ended = await self._failed(job, error)
        except Exception as error:  # noqa: BLE001  whatever a job does, it ends as that job's failure
            ended = await self._failed(job, error)
        if ended:
            self.note_end(ended)

    async def _computed(self, job: JobRecord) -> JobRecord | None:
        """Have a job computed and its result stored; None if it was ended by somebody else meanwhile."""
        if job.kind == "shape":
            key = UploadKey(job.mesh_sha256 or "", job.parameters, job.policy)
            if await self._library.store.fetch(partial(rows.find_shape, key=key)):  # by a job of the same file
                return await self._made(partial(_end_with_known, job=job, key=key))
        policy, url = MeshPolicy.from_json(job.policy), self._library.store.url
        mesh = StoredMesh(url, job.mesh_sha256 or "", job.file_type, policy, self._limits.mesh)
        listener = partial(self._news.report, job.id)
        if job.kind == "file":
            file = FileTask(mesh, job.request["call"], job.request["arguments"])
            data = await self._pool.call(make_file, (file,), self._limits.seconds, listener)
            made = JobFile(job.request["file_type"], job.request["name"], data)
            return await self._made(partial(_store_file, job=job, file=made))
        outcome = await self._pool.call(compute, (Task(mesh, job.parameters),), self._limits.seconds, listener)
        self._observer.computed(outcome.seconds)
        if job.kind == "query":
            ranking = await asyncio.to_thread(self._library.rank, outcome.signature.unpack(), **job.request)
            answer = partial(queue.finish, job_id=job.id, state="succeeded", result=ranking.as_dict())
            return await self._made(partial(answer, warnings=ranking.warnings))
        return await self._made(partial(_store_shape, job=job, outcome=outcome))

    async def _failed(self, job: JobRecord, error: Exception) -> JobRecord | None:
        why = describe(typed_error(error))
        report = self._news.last(job.id) or Report(job.stage, job.progress)
        reached = {"stage": report.stage, "progress": report.share}
        return await self._made(
            lambda connection: queue.finish(connection, job.id, "failed", error=why, reached=reached)
        )

    async def _made(self, change: Callable[[Connection], T]) -> T:
        """Make a change, again and again where the store cannot: what was computed, or claimed, is not lost by that."""
        until = math.inf
        while True:
            try:
                return await asyncio.wrap_future(self._writer.submit(change))
            except StoreError as error:
                if self._is_stopping:
                    until = min(until, time.monotonic() + _LAST_SECONDS)
                if isinstance(error, NotFoundError) or time.monotonic() >= until:
                    raise
                logger.exception("the store cannot be written; trying again")
                await asyncio.sleep(_RETRY_SECONDS)

    def _recover(self, connection: Connection) -> list[JobRecord]:
        """Put jobs that were cut off back into the queue; return those that end here, for it was too often."""
        ended = []
        for job in queue.running_jobs(connection):
            if job.restarts < self._limits.restarts:
                queue.give_back(connection, job.id, lost="server")
            elif done := queue.finish(connection, job.id, "failed", error=describe(_LOST)):
                ended.append(done)
        return ended


def _give_all_back(connection: Connection) -> None:
    """Put every job that is running in the store back: nobody has one in hand any more."""
    for job in queue.running_jobs(connection):
        queue.give_back(connection, job.id, lost="nothing")


async def _all_ended(tasks: Collection[asyncio.Task[None]]) -> None:
    await asyncio.wait(tasks)


def what_was_sent(request: Mapping[str, Any]) -> tuple[dict[str, Any], rows.IfKnown]:
    """Return what an upload says of its shape, and what becomes of it where the shape is stored already."""
    return {name: request[name] for name in request.get("sent", ())}, request.get("if_known", "keep")


def _end_with_known(connection: Connection, job: JobRecord, key: UploadKey) -> JobRecord | None:
    """End an upload whose shape is stored already; put it back if that shape was removed meanwhile."""
    known = rows.find_shape(connection, key)
    if known is None:
        queue.give_back(connection, job.id, lost="nothing")
        return None
    if queue.get_job(connection, job.id).finished:  # cancelled meanwhile
        return None
    told = rows.describe_anew(connection, known, *what_was_sent(job.request))
    return queue.finish(
        connection, job.id, "succeeded", shape_id=known.id, warnings=known.warnings, ignored=told.ignored
    )


def _store_file(connection: Connection, job: JobRecord, file: JobFile) -> JobRecord | None:
    rows.get_shape(connection, job.shape_id or "")  # it may have been removed meanwhile
    return queue.finish(connection, job.id, "succeeded", shape_id=job.shape_id, file=file)


def _store_shape(connection: Connection, job: JobRecord, outcome: Outcome) -> JobRecord | None:
    if queue.get_job(connection, job.id).finished:  # cancelled while the result was on its way
        return None
    new = rows.NewShape(
        sha256=job.mesh_sha256 or "", policy=MeshPolicy.from_json(job.policy), signature=outcome.signature,
        area=outcome.area, report=outcome.report, name=job.request["name"], label=job.request["label"],
        metadata=job.request["metadata"],
    )  # fmt: skip
    if rows.find_shape(connection, new.key):  # by `Library.add` in another process
        return _end_with_known(connection, job, new.key)
    shape_id = rows.add_shape(connection, new)
    return queue.finish(connection, job.id, "succeeded", shape_id=shape_id, warnings=outcome.signature.warnings)
