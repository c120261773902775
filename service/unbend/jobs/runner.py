"""The job runner: submit, read, wait for, follow and cancel jobs."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
from collections.abc import AsyncIterator, Callable, Mapping
from concurrent.futures import Future
from contextvars import Context, copy_context
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from typing import TYPE_CHECKING, Any, Final, Literal, TypeVar, get_args

from unbend.errors import CallTimeoutError, JobCancelledError, JobTimeoutError, NotFoundError, QueueFullError
from unbend.extras import extra
from unbend.jobs.dispatcher import Dispatcher
from unbend.jobs.execution import Execution
from unbend.jobs.failures import describe, typed_error
from unbend.jobs.limits import JobLimits
from unbend.jobs.observer import CURRENT_JOB, JobObserver, NoObserver
from unbend.jobs.pool import WorkerPool
from unbend.jobs.subscriptions import Subscriptions
from unbend.library import Library
from unbend.library.jobs import ANONYMOUS, JobFilter, NewJob, QueueLimits, Sender
from unbend.library.records import JobFile, JobPage, JobRecord
from unbend.library.requests import FileRequest, QueryRequest, ShapeRequest, Upload
from unbend.library.shape_rows import MAX_PAGE
from unbend.results.jobs import UNFINISHED_STATES
from unbend.results.shapes import AddedShape, ShapeRecord

if TYPE_CHECKING:
    from unbend.jobs.cluster.dispatcher import ClusterDispatcher

T = TypeVar("T")
K = TypeVar("K")

_STEP_SECONDS: Final = 0.25
"""Shortest time between two progress events of `follow`."""
_HEARTBEAT_SECONDS: Final = 2.5
"""Time without progress after which `follow` repeats the last event."""

Lane = Literal["small", "large"]


@dataclass
class _Lane:
    pool: WorkerPool
    calls: int = 0


class JobRunner:
    """Runs the jobs of a library; made and used within one event loop.

    A job is durable when a `submit` method returns it. Jobs that an earlier server left running are run again, up to
    `limits.restarts` times.

    Parameters
    ----------
    library : Library
    workers : int
        Number of worker processes.
    limits : JobLimits, optional
    observer : JobObserver, optional
        Receives what happens to jobs.
    with_parts : bool, default True
        Whether the signatures of uploads get local signatures, which the measures of parts compare.
    """

    def __init__(
        self,
        library: Library,
        *,
        workers: int,
        limits: JobLimits | None = None,
        observer: JobObserver | None = None,
        with_parts: bool = True,
    ) -> None:
        self.workers = workers
        self.limits = limits or JobLimits()
        self._jobs = library.jobs
        self._subscriptions = Subscriptions()
        self._pool = WorkerPool(workers, self.limits.memory_mb)
        # Separate processes for calls: calls do not wait for jobs, and short calls do not wait for long calls. Each
        # process starts when it is first needed.
        self._lanes = {lane: _Lane(WorkerPool(1, self.limits.memory_mb)) for lane in get_args(Lane)}
        self._observer: JobObserver = observer or NoObserver()
        self._dispatcher = self._new_dispatcher(library, with_parts=with_parts)
        self._warming: asyncio.Task[None] | None = None

    def _new_dispatcher(self, library: Library, *, with_parts: bool) -> Dispatcher | ClusterDispatcher:
        executing = partial(
            Execution, library, self._pool, self.limits, self._observer, self._subscriptions, with_parts=with_parts
        )
        connecting = library.store.postgres
        if connecting is None:
            self._execution = executing(report=self._subscriptions.report)
            return Dispatcher(library, self._pool, self.limits, self._execution, self._subscriptions)
        with extra("cluster"):
            from unbend.jobs.cluster.dispatcher import ClusterDispatcher  # noqa: PLC0415
            from unbend.jobs.cluster.news import News  # noqa: PLC0415
        news = News(connecting, self._subscriptions)
        self._execution = executing(report=news.report)
        return ClusterDispatcher(
            library, self._pool, self.limits, self._execution, self._subscriptions, news, connecting
        )

    async def start(self) -> None:
        """Recover the jobs of an earlier server, start to claim jobs, and warm up the workers meanwhile."""
        self._subscriptions.open()
        self._warming = asyncio.create_task(self._pool.start(), name="unbend warm-up")
        await self._dispatcher.start()

    async def stop(self) -> None:
        """Claim no more jobs, give running ones `limits.drain_seconds`, and requeue the rest."""
        self._subscriptions.close()
        if self._warming:
            self._warming.cancel()
            await asyncio.gather(self._warming, return_exceptions=True)
        await self._dispatcher.stop()
        for pool in (self._pool, *(lane.pool for lane in self._lanes.values())):
            await asyncio.to_thread(pool.stop)

    def stop_now(self) -> None:
        """Make `stop` wait no longer for running jobs; safe in a signal handler."""
        self._dispatcher.stop_now()

    def end_waits(self) -> None:
        """End every `wait` and `follow` with the job's present state; safe in a signal handler."""
        self._subscriptions.close_soon()

    @property
    def alive(self) -> bool:
        """Whether the dispatcher runs, and the workers did not fail to start."""
        warming = self._warming
        failed = warming is not None and warming.done() and (warming.cancelled() or warming.exception() is not None)
        return self._dispatcher.alive and not failed

    @property
    def ready(self) -> bool:
        """Whether the dispatcher runs, and every worker has started and loaded its kernels."""
        return self.alive and self._warming is not None and self._warming.done()

    @property
    def running(self) -> int:
        """Number of jobs that this process has claimed."""
        return self._dispatcher.running

    @property
    def capacity(self) -> tuple[int, int]:
        """Numbers of worker processes and of claimed jobs, in all processes that share the library."""
        return self._dispatcher.capacity

    async def submit_shape(
        self, upload: Upload, request: ShapeRequest, sender: Sender = ANONYMOUS, most_owned: int | None = None
    ) -> JobRecord | AddedShape:
        """Queue an upload; or return the shape if it is stored already, or the earlier job of a repeated request.

        Parameters
        ----------
        upload : Upload
        request : ShapeRequest
        sender : Sender, optional
        most_owned : int, optional
            Maximum number of queued and running jobs of the sender's API key.

        Raises
        ------
        QueueFullError
            If `limits.queued` jobs wait already.
        QuotaError
            If the sender has `most_owned` queued and running jobs already.
        IdempotencyError
            If the sender sent a different request with this idempotency key.
        """
        return await self._submitted(self._jobs.submit_shape(upload, request, sender, self._queue_limits(most_owned)))

    async def submit_query(
        self, upload: Upload, request: QueryRequest, sender: Sender = ANONYMOUS, most_owned: int | None = None
    ) -> JobRecord:
        """Queue a query, or return the earlier job of a repeated request; arguments and errors as in `submit_shape`."""
        return await self._submitted(self._jobs.submit_query(upload, request, sender, self._queue_limits(most_owned)))

    async def submit_file(
        self, shape: ShapeRecord, request: FileRequest, sender: Sender = ANONYMOUS, most_owned: int | None = None
    ) -> JobRecord:
        """Queue a job that makes a file of a stored shape; `file` returns the file once the job has succeeded."""
        return await self._submitted(self._jobs.submit_file(shape, request, sender, self._queue_limits(most_owned)))

    async def status(self, job_id: str) -> JobRecord:
        """Return a job with its live progress; NotFoundError if there is none of this id."""
        return self._live(await self._jobs.get(job_id))

    async def page(self, conditions: JobFilter, *, cursor: str | None, limit: int) -> tuple[JobPage, Mapping[str, int]]:
        """Return up to `limit` jobs without results, the newest first, and their queue positions by id."""
        page, positions = await self._jobs.page(conditions, cursor=cursor, limit=limit)
        return dataclasses.replace(page, items=[self._live(job) for job in page.items]), positions

    async def queued(self) -> int:
        """Return the number of queued jobs."""
        return await self._jobs.count_queued()

    async def position(self, job: JobRecord) -> int | None:
        """Return the number of jobs that start before a queued job; None if the job is not queued."""
        return await self._jobs.position(job)

    async def wait(self, job_id: str, seconds: float) -> JobRecord:
        """Return a job when it has ended, or after `seconds` in its present state."""
        end = asyncio.get_running_loop().time() + seconds
        with self._subscriptions.subscribe(job_id) as subscription:
            while True:
                subscription.clear()
                job = await self.status(job_id)  # read again after the last wait, so that the state is current
                left = end - asyncio.get_running_loop().time()
                if job.finished or self._subscriptions.closed or left <= 0:
                    return job
                await subscription.wait_for_state(left)

    async def follow(self, job_id: str) -> AsyncIterator[JobRecord]:
        """Yield a job at each change of state, and with new progress at most four times a second.

        Without progress, the job is repeated every few seconds. The last item is the ended job, or, when the server
        stops, the job in its present state.

        Raises
        ------
        NotFoundError
            If there is no such job.
        """
        with self._subscriptions.subscribe(job_id, to_progress=True) as subscription:
            job = await self.status(job_id)
            while True:
                yield job
                if job.finished or self._subscriptions.closed:
                    return
                changed = await subscription.wait_for_state(_STEP_SECONDS)
                if not changed:
                    await subscription.wait(_HEARTBEAT_SECONDS)
                    changed = await subscription.wait_for_state(0.0)
                subscription.clear()
                job = await self.status(job_id) if changed else self._live(job)

    async def follow_all(self) -> AsyncIterator[JobRecord | None]:
        """Yield the unfinished jobs, at most 500 in each state, then each job that progresses or changes its state.

        A job is yielded at most four times a second. None is yielded after a few seconds without a change. The
        iterator ends when the server stops.
        """
        with self._subscriptions.subscribe_to_all() as feed:
            for state in UNFINISHED_STATES:
                page, _ = await self.page(JobFilter(state=state), cursor=None, limit=MAX_PAGE)
                for job in reversed(page.items):
                    yield job
            while not self._subscriptions.closed:
                changed = await feed.wait(_HEARTBEAT_SECONDS)
                for job_id in changed:
                    with contextlib.suppress(NotFoundError):  # deleted meanwhile
                        yield await self.status(job_id)
                if changed:
                    await asyncio.sleep(_STEP_SECONDS)
                else:
                    yield None

    async def call(self, function: Callable[..., T], *arguments: object, lane: Lane = "small") -> T:
        """Run a function in a worker process at once, without the queue, while a client waits for it.

        Parameters
        ----------
        function, arguments
            Pickled, as is the result.
        lane : {"small", "large"}
            Each lane has its own process, so that long calls delay only other long calls.

        Raises
        ------
        QueueFullError
            If `limits.calls` calls wait or run in this lane already.
        UnbendError
            As raised by the function; CallTimeoutError after `limits.call_seconds`.
        """
        chosen = self._lanes[lane]
        if chosen.calls >= self.limits.calls:
            raise QueueFullError(f"{chosen.calls} requests of this kind wait or run already")
        chosen.calls += 1
        try:
            async with asyncio.timeout(self.limits.call_seconds):
                return await chosen.pool.call(function, arguments, self.limits.call_seconds)
        except TimeoutError:
            raise CallTimeoutError(f"the request took longer than {self.limits.call_seconds:g} seconds") from None
        except JobTimeoutError as error:
            raise CallTimeoutError(str(error)) from None
        except Exception as error:
            raise typed_error(error) from error
        finally:
            chosen.calls -= 1

    async def file(self, job: JobRecord) -> JobFile:
        """Return the file of a job; NotFoundError if the job has none."""
        return await self._jobs.file(job)

    async def delete_ended(self, before: datetime, owner: str | None = None) -> int:
        """Delete the jobs of one API key, or of all callers, that ended before an instant; return their number."""
        return await self._execution.delete_ended(before=before, owner=owner)

    async def cancel(self, job_id: str) -> JobRecord:
        """Cancel a job. A queued job never starts, a running job's process is killed, an ended job does not change."""
        error = describe(JobCancelledError("the job was cancelled"))
        CURRENT_JOB.set(job_id)
        reached = self._subscriptions.progress(job_id)
        ended = await asyncio.wrap_future(self._jobs.cancel(job_id, error, reached))
        if ended:
            self._dispatcher.kill(job_id)
            self._execution.announce_end(ended)
        return await self.status(job_id)

    def _queue_limits(self, most_owned: int | None) -> QueueLimits:
        return QueueLimits(self.limits.queued, most_owned, self.capacity[0])

    async def _submitted(self, future: Future[NewJob | K]) -> JobRecord | K:
        """Wait until a submission is on disk; return the new job, or the existing job or shape."""
        # The callback runs even if the client disconnects, and before the dispatcher can claim the job.
        future.add_done_callback(partial(self._observe_submission, copy_context()))
        outcome = await asyncio.wrap_future(future)
        found = outcome.job if isinstance(outcome, NewJob) else outcome
        if isinstance(found, JobRecord):
            CURRENT_JOB.set(found.id)
            self._subscriptions.notify_state(found.id)
        self._dispatcher.wake()
        return found

    def _observe_submission(self, context: Context, future: Future[Any]) -> None:
        """Notify the observer of a new job, in the context of its request."""
        if not future.cancelled() and future.exception() is None and isinstance(future.result(), NewJob):
            context.run(self._observer.submitted, future.result().job)

    def _live(self, job: JobRecord) -> JobRecord:
        progress = self._subscriptions.progress(job.id) if job.state == "running" else None
        if progress is None:
            return job
        return dataclasses.replace(job, stage=progress.stage, progress=progress.share, detail=dict(progress.detail))
