"""What the faces ask of jobs: submit, look, wait, follow, cancel."""

from __future__ import annotations

import asyncio
import dataclasses
from collections.abc import AsyncIterator, Callable, Mapping
from concurrent.futures import Future
from contextvars import Context, copy_context
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import partial
from typing import Any, Final, Literal, TypeVar, get_args

from sqlalchemy import Connection

from unbend.errors import (
    CallTimeoutError,
    IdempotencyError,
    JobCancelledError,
    JobTimeoutError,
    QueueFullError,
    QuotaError,
)
from unbend.jobs.dispatcher import Dispatcher, what_was_sent
from unbend.jobs.failures import describe, typed_error
from unbend.jobs.limits import JobLimits
from unbend.jobs.news import News
from unbend.jobs.observer import CURRENT_JOB, JobObserver, NoObserver
from unbend.jobs.pool import WorkerPool
from unbend.library import Library, queue
from unbend.library import shapes as rows
from unbend.library.key import UploadKey
from unbend.library.queue import NOBODY, JobFilter, Sender
from unbend.library.records import JobFile, JobKind, JobPage, JobRecord, ShapeRecord
from unbend.library.writer import Writer
from unbend.mesh.policy import MeshPolicy
from unbend.signature.parameters import Parameters

T = TypeVar("T")

IDEMPOTENCY: Final = timedelta(hours=24)
"""How long a request that is sent again under its name is known."""

_STEP_SECONDS: Final = 0.25  # between two looks at a job that somebody follows
_QUIET_SECONDS: Final = 2.5  # after which a follower is told where the job stands, be it news or not


@dataclass(frozen=True)
class Upload:
    """A file to compute: its bytes, its name's extension where the content does not tell the format, how to read it."""

    data: bytes
    file_type: str
    parameters: Parameters
    policy: MeshPolicy


Lane = Literal["small", "large"]


@dataclass
class _Lane:
    pool: WorkerPool
    calls: int = 0


@dataclass(frozen=True)
class WantedFile:
    """A file to make of a stored shape: which call of `FILE_CALLS`, its arguments, and what the file is called."""

    call: str
    arguments: Mapping[str, Any]
    file_type: str
    name: str


@dataclass(frozen=True)
class _New:
    job: JobRecord


@dataclass(frozen=True)
class _Order:
    kind: JobKind
    key: UploadKey
    upload: Upload
    request: dict[str, Any]
    sender: Sender
    most: int | None


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
        self._news = News()
        self._writer = Writer(library.store)
        self._pool = WorkerPool(workers, self.limits.memory_mb)
        # Processes of their own for what somebody waits for, so that no reader waits for jobs, and nobody who asks for
        # little waits for those who ask for much; each is started when first needed.
        self._lanes = {lane: _Lane(WorkerPool(1, self.limits.memory_mb)) for lane in get_args(Lane)}
        self._observer: JobObserver = observer or NoObserver()
        self._dispatcher = Dispatcher(library, self._writer, self._pool, self.limits, self._observer, self._news)
        self._warming: asyncio.Task[None] | None = None

    async def start(self) -> None:
        """Take up what an earlier process left, begin, and warm the workers meanwhile."""
        self._news.open()
        self._warming = asyncio.create_task(self._pool.start(), name="unbend warm-up")
        await self._dispatcher.start()

    async def stop(self) -> None:
        """Stop claiming, give running jobs `limits.drain_seconds`, put the rest back into the queue."""
        self._news.close_now()
        if self._warming:
            self._warming.cancel()
            await asyncio.gather(self._warming, return_exceptions=True)
        await self._dispatcher.stop()
        for pool in (self._pool, *(lane.pool for lane in self._lanes.values())):
            await asyncio.to_thread(pool.stop)
        await asyncio.to_thread(self._writer.close)

    def hurry(self) -> None:
        """Have a `stop` that is under way give running jobs no more time; safe to call from a signal handler."""
        self._dispatcher.hurry()

    def end_waits(self) -> None:
        """Answer everybody who waits for a job with the job as it is; safe to call from a signal handler."""
        self._news.close()

    @property
    def alive(self) -> bool:
        """Whether the dispatcher runs, and workers could be started."""
        warming = self._warming
        failed = warming is not None and warming.done() and (warming.cancelled() or warming.exception() is not None)
        return self._dispatcher.alive and not failed

    @property
    def ready(self) -> bool:
        """Whether the workers have their kernels loaded."""
        return self.alive and self._warming is not None and self._warming.done()

    @property
    def running(self) -> int:
        """How many jobs are in hand."""
        return self._dispatcher.running

    async def submit(
        self, kind: JobKind, upload: Upload, request: dict[str, Any], sender: Sender = NOBODY, most: int | None = None
    ) -> JobRecord | rows.Known:
        """Queue a computation, durably; or return the stored shape, or the job that was sent before, that is the same.

        Parameters
        ----------
        kind : JobKind
        upload : Upload
        request : dict
            Of a query, what is asked. Of a shape `name`, `label` and `metadata`; `sent`, which of these the caller
            gave; `if_known`, "keep" or "update".
        sender : Sender, optional
        most : int, optional
            Jobs that the sender may have waiting or running.

        Raises
        ------
        QueueFullError
            If `limits.queued` jobs wait already.
        QuotaError
            If the sender has `most`.
        IdempotencyError
            If the sender sent something else under the same name.
        """
        key = UploadKey.of(upload.data, upload.parameters, upload.policy)
        order = _Order(kind, key, upload, request, sender, most)
        return await self._queued(lambda connection: self._enqueue(connection, order))

    async def status(self, job_id: str) -> JobRecord:
        """Return a job with its live progress; NotFoundError if there is none."""
        return self._live(await self._library.store.fetch(partial(queue.get_job, job_id=job_id)))

    async def page(self, which: JobFilter, *, cursor: str | None, limit: int) -> tuple[JobPage, Mapping[str, int]]:
        """Return some jobs as summaries, the newest first, and how many wait before each that waits, by id."""
        page, ahead = await asyncio.to_thread(self._page, which, cursor, limit)
        return dataclasses.replace(page, items=[self._live(job) for job in page.items]), ahead

    async def queued(self) -> int:
        """Return how many jobs wait."""
        return await self._library.store.fetch(queue.count_queued)

    async def position(self, job: JobRecord) -> int | None:
        """Return how many jobs are to be begun before a queued one."""
        if job.state != "queued":
            return None
        return await self._library.store.fetch(partial(queue.position, job=job))

    async def wait(self, job_id: str, seconds: float) -> JobRecord:
        """Return a job when it has ended, or as it is after `seconds`."""
        end = asyncio.get_running_loop().time() + seconds
        with self._news.listening(job_id) as listener:
            while True:
                listener.listen_anew()
                job = await self.status(job_id)  # also after the last wait: an answer is never older than that
                left = end - asyncio.get_running_loop().time()
                if job.finished or self._news.closed or left <= 0:
                    return job
                await listener.change(left)

    async def follow(self, job_id: str) -> AsyncIterator[JobRecord]:
        """Yield a job as it is: when it moves, four times a second at most, at once when its state changes.

        Where it does not move, it is yielded all the same, every few seconds. The last is the ended job, or, where the
        server stops, the job as it is then.

        Raises
        ------
        NotFoundError
            If there is no such job.
        """
        with self._news.listening(job_id, to_moves=True) as listener:
            job = await self.status(job_id)
            while True:
                yield job
                if job.finished or self._news.closed:
                    return
                changed = await listener.change(_STEP_SECONDS)
                if not changed:
                    await listener.move(_QUIET_SECONDS)
                    changed = await listener.change(0.0)
                listener.listen_anew()
                job = await self.status(job_id) if changed else self._live(job)

    async def call(self, function: Callable[..., T], *arguments: object, lane: Lane = "small") -> T:
        """Run a function on stored data in a process, past the queue, while somebody waits for it.

        Parameters
        ----------
        function, arguments
            They travel to the process, and the result back.
        lane : "small" or "large", default "small"
            Each has a process of its own, so that what takes long holds up only what takes long.

        Raises
        ------
        QueueFullError
            If `limits.calls` wait in this lane already.
        UnbendError
            As the function does, or as a job would fail; JobTimeoutError after `limits.call_seconds`.
        """
        chosen = self._lanes[lane]
        if chosen.calls >= self.limits.calls:
            raise QueueFullError(f"{chosen.calls} others wait for such an answer already")
        chosen.calls += 1
        try:
            async with asyncio.timeout(self.limits.call_seconds):
                return await chosen.pool.call(function, arguments, self.limits.call_seconds)
        except TimeoutError:
            raise CallTimeoutError(f"this took longer than {self.limits.call_seconds:g} seconds") from None
        except JobTimeoutError as error:
            raise CallTimeoutError(str(error)) from None
        except Exception as error:
            raise typed_error(error) from error
        finally:
            chosen.calls -= 1

    async def submit_file(self, shape: ShapeRecord, wanted: WantedFile, sender: Sender = NOBODY) -> JobRecord:
        """Queue the making of a file of a stored shape; `file` has it once the job has succeeded."""
        key = UploadKey(shape.sha256, Parameters.from_dict(shape.parameters).to_json(), _text(shape.policy))
        request = {**vars(wanted), "arguments": dict(wanted.arguments)}

        def enqueue(connection: Connection) -> _New:
            rows.get_shape(connection, shape.id)
            waiting = queue.count_queued(connection)
            if waiting >= self.limits.queued:
                raise QueueFullError(f"{waiting} jobs wait already")
            job = queue.enqueue(
                connection, kind="file", key=key, file_type=str(shape.report["file_type"]), request=request,
                sender=sender, shape_id=shape.id,
            )  # fmt: skip
            return _New(job)

        return await self._queued(enqueue)

    async def file(self, job: JobRecord) -> JobFile:
        """Return what a job of the kind "file" made; NotFoundError where there is none."""
        return await asyncio.to_thread(self._file, job)

    def _file(self, job: JobRecord) -> JobFile:
        with self._library.store.read() as connection:
            return queue.get_file(connection, job)

    async def forget(self, before: datetime, owner: str | None = None) -> int:
        """Forget the jobs, or those of one key, that ended before; return how many."""
        return await self._dispatcher.forget(before=before, owner=owner)

    async def cancel(self, job_id: str) -> JobRecord:
        """Cancel a job: a queued one is never run, a running one's process is killed; an ended one stays."""
        error = describe(JobCancelledError("the job was cancelled"))
        CURRENT_JOB.set(job_id)
        report = self._news.last(job_id)
        reached = {"stage": report.stage, "progress": report.share} if report else None
        ended = await self.write(
            lambda connection: queue.finish(connection, job_id, "cancelled", error=error, reached=reached)
        )
        if ended:
            self._dispatcher.drop(job_id)
            self._dispatcher.note_end(ended)
        return await self.status(job_id)

    async def write(self, change: Callable[[Connection], T]) -> T:
        """Have a change made to the library, in its turn, and wait until it is on disk; no thread waits meanwhile."""
        return await asyncio.wrap_future(self._writer.submit(change))

    async def _queued(self, enqueue: Callable[[Connection], _New | T]) -> JobRecord | T:
        """Have a job queued; return it, or what is there in its place."""
        future = self._writer.submit(enqueue)
        # Called as soon as the job is on disk, be the client still there or not, and before anybody can begin it.
        future.add_done_callback(partial(self._note_new, copy_context()))
        answer = await asyncio.wrap_future(future)
        found = answer.job if isinstance(answer, _New) else answer
        if isinstance(found, JobRecord):
            CURRENT_JOB.set(found.id)
        self._dispatcher.wake()
        return found

    def _note_new(self, context: Context, future: Future[Any]) -> None:
        """Tell the observer of a new job, in the context of the request that it came with."""
        if not future.cancelled() and future.exception() is None and isinstance(future.result(), _New):
            context.run(self._observer.submitted, future.result().job)

    def _enqueue(self, connection: Connection, order: _Order) -> _New | JobRecord | rows.Known:
        sender = order.sender
        if sender.idempotency and (
            before := queue.find_sent(connection, sender.idempotency, datetime.now(UTC) - IDEMPOTENCY)
        ):
            if before.fingerprint != sender.fingerprint:
                raise IdempotencyError("another request was sent with this Idempotency-Key")
            return before
        if order.kind == "shape" and (shape := rows.find_shape(connection, order.key)):
            return rows.describe_anew(connection, shape, *what_was_sent(order.request))
        self._check_room(connection, order)
        rows.put_mesh(connection, order.key.sha256, order.upload.data)
        job = queue.enqueue(
            connection, kind=order.kind, key=order.key, file_type=order.upload.file_type, request=order.request,
            sender=sender,
        )  # fmt: skip
        return _New(job)

    def _check_room(self, connection: Connection, order: _Order) -> None:
        self._library.store.admit(len(order.upload.data))
        waiting = queue.count_queued(connection)
        if waiting >= self.limits.queued:
            raise QueueFullError(f"{waiting} jobs wait already", retry_after=max(1, waiting // (50 * self.workers)))
        owner = order.sender.owner
        if order.most is not None and owner and queue.count_unfinished(connection, owner) >= order.most:
            raise QuotaError(f"{order.most} jobs of this key wait or run already, as many as it may have")

    def _page(self, which: JobFilter, cursor: str | None, limit: int) -> tuple[JobPage, Mapping[str, int]]:
        with self._library.store.read() as connection:
            page = queue.list_jobs(connection, which, cursor=cursor, limit=limit)
            return page, queue.positions(connection, page.items)

    def _live(self, job: JobRecord) -> JobRecord:
        live = self._news.last(job.id) if job.state == "running" else None
        if live is None:
            return job
        return dataclasses.replace(job, stage=live.stage, progress=live.share, detail=dict(live.detail))


def _text(policy: Mapping[str, Any]) -> str:
    return MeshPolicy.from_dict(policy).to_json()
