"""The dispatcher of one process of a cluster: it takes tickets from Procrastinate's queue, and runs a job for each.

A ticket does not name a job: it is the right to claim the next one. The order of jobs, and the turns of API keys, are
those of `Jobs.claim`, as in a library with one server. PostgreSQL makes a ticket in each transaction that queues a job.
Procrastinate delivers each ticket to one worker, and knows by their heartbeats which workers have died.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import uuid
from collections.abc import Callable, Collection, Mapping
from concurrent.futures import Future
from functools import partial
from typing import Any, Final

from procrastinate import App, JobContext, PsycopgConnector
from procrastinate.exceptions import ConnectorException
from psycopg import AsyncConnection, OperationalError
from psycopg import Error as PsycopgError
from psycopg_pool import AsyncConnectionPool, PoolClosed, PoolTimeout

from unbend.errors import NotFoundError, StoreError, WorkerLostError
from unbend.jobs.cluster.news import News, WorkerNews
from unbend.jobs.execution import RETRY_SECONDS, Execution
from unbend.jobs.failures import describe
from unbend.jobs.limits import JobLimits
from unbend.jobs.pool import WorkerPool
from unbend.jobs.subscriptions import Subscriptions
from unbend.library import Library
from unbend.library.records import JobRecord
from unbend.library.storage.queue_schema import QUEUE, TASK

logger = logging.getLogger("unbend.jobs")

HEARTBEAT_SECONDS: Final = 5.0
"""Time between two heartbeats of a worker."""

LOST_SECONDS: Final = 20.0
"""Time without a heartbeat after which a worker counts as dead."""

_CHECK_SECONDS: Final = 5.0
"""Time between two searches for jobs of dead workers."""

_POLL_SECONDS: Final = 2.0
"""Time between two searches for tickets whose announcement was lost."""

_QUEUE_OPTIONS: Final = "-c plan_cache_mode=force_custom_plan -c enable_sort=off -c synchronous_commit=off"
"""Options of the connections that take and return tickets.

A plan that was made while the queue was empty, or before PostgreSQL has its statistics, would read the whole queue for
each ticket. A crash of the database may return a used ticket to the queue, where it does no harm.
"""

_SHORTEST_WAIT: Final = 0.01
"""Seconds between the first two attempts to claim a job. Another claim may have the queue's rows for a moment."""

_LONGEST_WAIT: Final = 0.5
"""Seconds between two later attempts, while every queued upload waits for an equal one that runs."""

_ENDING_SECONDS: Final = 5.0
"""Time that a stopping worker has to return its jobs to the queue."""


class ClusterDispatcher:
    """Runs queued jobs that no other process runs. Used within one event loop.

    A process without workers runs none. It only hears of the jobs that others run.
    """

    def __init__(
        self,
        library: Library,
        pool: WorkerPool,
        limits: JobLimits,
        execution: Execution,
        subscriptions: Subscriptions,
        news: News,
        connecting: Mapping[str, Any],
    ) -> None:
        self._jobs = library.jobs
        self._pool = pool
        self._limits = limits
        self._execution = execution
        self._subscriptions = subscriptions
        self._news = news
        self._connecting = connecting
        self._running: dict[str, tuple[JobRecord, asyncio.Task[None]]] = {}
        self._tasks: list[asyncio.Task[None]] = []
        self._checks: set[asyncio.Task[None]] = set()
        self._is_stopping = False

    async def start(self) -> None:
        """Start to listen for news, and to take tickets."""
        self._news.start(self.check, self._running.__contains__)
        self._tasks = [asyncio.create_task(self._execution.trim_history(), name="unbend history")]
        if self._pool.size:
            self._tasks.append(asyncio.create_task(self._take_tickets(), name="unbend dispatcher"))
            self._tasks.append(asyncio.create_task(self._recover_jobs(), name="unbend recovery"))
            self._tasks.append(asyncio.create_task(self._report(), name="unbend report"))

    async def stop(self) -> None:
        """Take no more tickets, give running jobs `limits.drain_seconds`, and requeue the rest.

        If the database fails, another worker requeues them.
        """
        self._is_stopping = True
        self._execution.stop()
        for task in self._tasks:
            task.cancel()
        done = asyncio.gather(*self._tasks, return_exceptions=True)
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(done, self._limits.drain_seconds + _ENDING_SECONDS)
        await self._news.stop()

    def stop_now(self) -> None:
        """Make `stop` wait no longer for running jobs; safe in any thread."""
        for _, task in list(self._running.values()):
            task.get_loop().call_soon_threadsafe(task.cancel)

    @property
    def alive(self) -> bool:
        """Whether the process takes tickets, or has no workers."""
        return bool(self._tasks) and not any(task.done() for task in self._tasks)

    @property
    def running(self) -> int:
        """Number of jobs that this process has claimed."""
        return len(self._running)

    @property
    def capacity(self) -> tuple[int, int]:
        """Numbers of worker processes and of claimed jobs in the whole cluster, as last heard."""
        heard = self._news.workers(LOST_SECONDS)
        return sum(worker.processes for worker in heard), sum(worker.running for worker in heard)

    def wake(self) -> None:
        """Do nothing: PostgreSQL tells every process of a new job."""

    def kill(self, job_id: str) -> None:
        """Kill the process of a job if this process runs it; others hear of the cancellation."""
        if job_id in self._running:
            self._running[job_id][1].cancel()

    def check(self, job_id: str) -> None:
        """Kill the process of a job if it was cancelled, or given to another worker."""
        if job_id in self._running:
            checking = asyncio.create_task(self._check(job_id))
            self._checks.add(checking)  # the event loop itself does not keep tasks alive
            checking.add_done_callback(self._checks.discard)

    async def _report(self) -> None:
        """Tell the servers what this worker can do."""
        worker_id = uuid.uuid4().hex
        while True:
            self._news.report_worker(WorkerNews(worker_id, self._pool.size, len(self._running)))
            await asyncio.sleep(HEARTBEAT_SECONDS)

    async def _check(self, job_id: str) -> None:
        try:
            current = await self._jobs.get(job_id)
        except NotFoundError:
            current = None
        except StoreError:  # whatever the job still writes is ignored
            return
        if job_id in self._running:
            job, task = self._running[job_id]
            if current is None or current.finished or current.ticket != job.ticket:
                task.cancel()

    async def _take_tickets(self) -> None:
        """Run Procrastinate's worker, and begin again whenever the database was interrupted."""
        while True:
            app = App(connector=self._new_connector())
            app.task(name=TASK, queue=QUEUE, pass_context=True)(self._run_ticket)
            try:
                async with app.open_async():
                    await app.run_worker_async(
                        queues=[QUEUE],
                        # One more than there are processes, so that none waits for the database.
                        concurrency=self._pool.size + 1,
                        delete_jobs="always",
                        install_signal_handlers=False,
                        fetch_job_polling_interval=_POLL_SECONDS,
                        update_heartbeat_interval=HEARTBEAT_SECONDS,
                        stalled_worker_timeout=LOST_SECONDS,
                        shutdown_graceful_timeout=self._limits.drain_seconds,
                    )
            except (ConnectorException, PsycopgError, PoolTimeout) as error:
                logger.warning("the queue cannot be used; trying again: %s", error)
            await asyncio.sleep(RETRY_SECONDS)

    def _new_connector(self) -> PsycopgConnector:
        options = f"{self._connecting['options']} {_QUEUE_OPTIONS}"
        return _PatientConnector(
            kwargs={**self._connecting, "options": options},
            min_size=1,
            max_size=self._pool.size + 4,
            # Without a test of each connection before its use: this dispatcher begins again when one is lost.
            pool_factory=lambda **arguments: AsyncConnectionPool(
                **arguments | {"check": None, "configure": _commit_each_statement}
            ),
        )

    async def _send_heartbeats(self, context: JobContext) -> None:
        """Send heartbeats while a job runs: Procrastinate's worker sends none once it stops."""
        while context.job.worker_id is not None:
            await asyncio.sleep(HEARTBEAT_SECONDS)
            if self._is_stopping:
                with contextlib.suppress(ConnectorException):
                    await context.app.job_manager.update_heartbeat(context.job.worker_id)

    async def _run_ticket(self, context: JobContext) -> None:
        """Claim the next job that can start, and run it."""
        wait, claim = _SHORTEST_WAIT, self._jobs.claims(context.job.id)
        while (job := await self._claimed(claim)) is None:
            if not await self._count_queued():
                return
            await asyncio.sleep(wait)
            wait = min(2 * wait, _LONGEST_WAIT)
        task = asyncio.create_task(self._execution.run(job), name=f"unbend job {job.id}")
        self._running[job.id] = job, task
        heartbeats = asyncio.create_task(self._send_heartbeats(context))
        try:
            await asyncio.wait([task])
        except asyncio.CancelledError:  # this process stops, or has lost the queue
            task.cancel()
            await asyncio.wait([task])
            raise
        finally:
            heartbeats.cancel()
            self._running.pop(job.id)
            self._subscriptions.discard(job.id)
            if task.cancelled():  # does nothing if the job was cancelled
                await self._return(job)

    async def _claimed(self, claim: Callable[[], Future[JobRecord | None]]) -> JobRecord | None:
        """Return the job of a claim. If this is cancelled meanwhile, the job returns to the queue."""
        claiming = asyncio.create_task(self._execution.retry(claim))
        try:
            return await asyncio.shield(claiming)
        except asyncio.CancelledError:
            with contextlib.suppress(StoreError):
                if job := await claiming:
                    await self._return(job)
            raise

    async def _return(self, job: JobRecord) -> None:
        with contextlib.suppress(StoreError):
            await self._execution.retry(partial(self._jobs.requeue, job, "stopped"))

    async def _count_queued(self) -> int:
        try:
            return await self._jobs.count_queued()
        except StoreError:
            return 1  # ask again

    async def _recover_jobs(self) -> None:
        """Return the jobs of dead workers to the queue, and replace tickets that were lost.

        Whatever two searches in a row find is true: what one finds may have been claimed, or have ended, just now.
        """
        lost = describe(WorkerLostError("the worker that ran the job died"))
        suspects: Collection[int] = ()
        was_missing = 0
        while True:
            await asyncio.sleep(_CHECK_SECONDS)
            with contextlib.suppress(StoreError):
                found, missing = await self._jobs.tickets(LOST_SECONDS)
                for ticket in set(found).intersection(suspects):
                    logger.warning("the worker that ran the job of ticket %d is lost", ticket)
                    recovery = self._jobs.recover_ticket(ticket, self._limits.restarts, lost)
                    if ended := await asyncio.wrap_future(recovery):
                        self._execution.announce_end(ended)
                if (number := min(missing, was_missing)) > 0:
                    logger.warning("%d queued jobs have no ticket: they get new ones", number)
                    await asyncio.wrap_future(self._jobs.issue_tickets(number, LOST_SECONDS))
                suspects, was_missing = found, missing


class _PatientConnector(PsycopgConnector):
    """Repeats statements without a result, such as the return of a ticket, until the database answers.

    Procrastinate itself gives up the ticket. The ticket would then seem to be in use for as long as the worker lives.
    """

    async def execute_query_async(self, query: Any, **arguments: Any) -> None:
        while True:
            try:
                await super().execute_query_async(query, **arguments)
            except ConnectorException as error:
                if not isinstance(error.__cause__, OperationalError) or isinstance(error.__cause__, PoolClosed):
                    raise
                logger.warning("the queue cannot be used; trying again: %s", error.__cause__)
                await asyncio.sleep(RETRY_SECONDS)
            else:
                return


async def _commit_each_statement(connection: AsyncConnection[Any]) -> None:
    """Save the two round trips of a transaction: Procrastinate takes and returns a ticket by one statement each."""
    await connection.set_autocommit(True)
