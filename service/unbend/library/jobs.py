"""The durable queue of a library's jobs: every method that changes it submits one change to the store."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import partial
from typing import Any, Final, TypeVar

from sqlalchemy import Connection

from unbend.errors import IdempotencyError, QueueFullError, QuotaError
from unbend.library import job_rows, shape_rows, tickets
from unbend.library.job_rows import ANONYMOUS, Cause, JobFilter, Sender
from unbend.library.mesh_files import Keep, MeshFiles
from unbend.library.records import JobFile, JobPage, JobRecord
from unbend.library.requests import FileRequest, JobRequest, QueryRequest, ShapeRequest, Upload, UploadKey
from unbend.library.shape_rows import ComputedShape
from unbend.library.storage.postgres import lock
from unbend.library.storage.store import Store
from unbend.progress import Progress
from unbend.results.jobs import JobState
from unbend.results.rankings import Ranking
from unbend.results.shapes import AddedShape, ShapeRecord

T = TypeVar("T")

IDEMPOTENCY: Final = timedelta(hours=24)
"""Time during which a repeated request gets the job of the first."""

_CLAIMS_A_SECOND: Final = 50
"""Jobs that a worker finishes in a second at best, for the advice when to retry."""


@dataclass(frozen=True)
class QueueLimits:
    """Limits on the queue, checked by each submission."""

    queued: int
    """Largest number of queued jobs of all senders."""
    owned: int | None = None
    """Largest number of queued and running jobs of the sender's API key; None for no limit."""
    workers: int = 1
    """Worker processes of the queue, for the advice when to retry."""


@dataclass(frozen=True)
class NewJob:
    """A job that a submission added to the queue."""

    job: JobRecord


class Jobs:
    """The queue, states and results of jobs; thread-safe.

    Each method that returns a future submits one change to the store. The change is on disk when the future has its
    result.
    """

    def __init__(self, store: Store, files: MeshFiles) -> None:
        self._store = store
        self._files = files

    # Submission

    def submit_shape(
        self, upload: Upload, request: ShapeRequest, sender: Sender, limits: QueueLimits
    ) -> Future[NewJob | JobRecord | AddedShape]:
        """Queue an upload; or return the shape if it is stored already, or the earlier job of a repeated request.

        Raises
        ------
        QueueFullError
            If `limits.queued` jobs wait already.
        QuotaError
            If the sender has `limits.owned` queued and running jobs already.
        IdempotencyError
            If the sender sent a different request with this idempotency key.
        StoreFullError
            If the disk has no space for the file.
        """
        key, attempts = upload.key, _Attempts()  # hashed here, not in the writer's thread

        def submit(connection: Connection, keep: Keep) -> NewJob | JobRecord | AddedShape:
            if earlier := _find_sent(connection, attempts, sender):
                return earlier
            if known := shape_rows.find_shape(connection, key):
                return shape_rows.update_known(connection, known, request)
            return self._enqueue(connection, keep, attempts.job_id, key, upload, request, sender, limits)

        return self._files.submit(key.sha256, upload.open, submit)

    def submit_query(
        self, upload: Upload, request: QueryRequest, sender: Sender, limits: QueueLimits
    ) -> Future[NewJob | JobRecord]:
        """Queue a query, or return the earlier job of a repeated request; raises as `submit_shape` does."""
        key, attempts = upload.key, _Attempts()  # hashed here, not in the writer's thread

        def submit(connection: Connection, keep: Keep) -> NewJob | JobRecord:
            earlier = _find_sent(connection, attempts, sender)
            return earlier or self._enqueue(connection, keep, attempts.job_id, key, upload, request, sender, limits)

        return self._files.submit(key.sha256, upload.open, submit)

    def submit_file(
        self, shape: ShapeRecord, request: FileRequest, sender: Sender, limits: QueueLimits
    ) -> Future[NewJob | JobRecord]:
        """Queue a job that makes a file of a stored shape, or return the earlier job of a repeated request.

        Raises
        ------
        IdempotencyError
            If the sender sent a different request with this idempotency key.
        NotFoundError
            If the shape was removed meanwhile.
        QueueFullError
            If `limits.queued` jobs wait already.
        QuotaError
            If the sender has `limits.owned` queued and running jobs already.
        """
        key, attempts = UploadKey.of(shape.sha256, shape.parameters, shape.policy), _Attempts()

        def submit(connection: Connection) -> NewJob | JobRecord:
            if earlier := _find_sent(connection, attempts, sender):
                return earlier
            shape_rows.get_shape(connection, shape.id)
            _check_queue(connection, sender, limits)
            return NewJob(
                job_rows.enqueue(
                    connection,
                    job_id=attempts.job_id,
                    key=key,
                    file_type=shape.file_type,
                    request=request,
                    sender=sender,
                    shape_id=shape.id,
                )
            )

        return self._store.submit(submit)

    def _enqueue(
        self,
        connection: Connection,
        keep: Keep,
        job_id: str,
        key: UploadKey,
        upload: Upload,
        request: JobRequest,
        sender: Sender,
        limits: QueueLimits,
    ) -> NewJob:
        if self._store.disk:
            self._store.disk.admit_upload(upload.size if self._files.are_in_database else 0)
        _check_queue(connection, sender, limits)
        keep(connection)
        return NewJob(
            job_rows.enqueue(
                connection, job_id=job_id, key=key, file_type=upload.file_type, request=request, sender=sender
            )
        )

    # Execution

    def claim(self, ticket: int | None = None) -> Future[JobRecord | None]:
        """Start the next job and return it; None if no queued job can start."""
        return self.claims(ticket)()

    def claims(self, ticket: int | None) -> Callable[[], Future[JobRecord | None]]:
        """Return a function that does the same as `claim`, and may be called again after a StoreError.

        It then returns the job of the failed call, if that call claimed one and only its answer was lost.
        """
        runs = itertools.count()

        def claim(connection: Connection) -> JobRecord | None:
            if next(runs) and ticket is not None and (job := job_rows.claimed(connection, ticket)):
                return job  # an earlier run of this change was committed, but its connection was lost
            return job_rows.claim(connection, ticket)

        return partial(self._store.submit, claim, is_statement=True)

    def requeue(self, job: JobRecord, cause: Cause) -> Future[None]:
        """Return a running job to its old place in the queue."""
        return self._store.submit(partial(job_rows.requeue, job=job, cause=cause))

    def requeue_all(self) -> Future[None]:
        """Return every running job to the queue, because the server stops."""

        def requeue(connection: Connection) -> None:
            for job in job_rows.running_jobs(connection):
                job_rows.requeue(connection, job, cause="stopped")

        return self._store.submit(requeue)

    def recover(self, restarts: int, error: Mapping[str, Any]) -> Future[list[JobRecord]]:
        """Requeue the jobs of a server that died. Jobs with too many restarts fail with `error`, and are returned."""

        def recover(connection: Connection) -> list[JobRecord]:
            failed = []
            for job in job_rows.running_jobs(connection):
                if job.restarts < restarts:
                    job_rows.requeue(connection, job, cause="server lost")
                elif ended := job_rows.finish(connection, job.id, "failed", error=dict(error)):
                    failed.append(ended)
            return failed

        return self._store.submit(recover)

    def recover_ticket(self, ticket: int, restarts: int, error: Mapping[str, Any]) -> Future[JobRecord | None]:
        """Requeue the job of a worker that died. With too many restarts, it fails with `error` and is returned."""

        def recover(connection: Connection) -> JobRecord | None:
            job = job_rows.claimed(connection, ticket)
            if job is None or not job_rows.is_current(connection, job):
                return None
            if job.restarts < restarts:
                job_rows.requeue(connection, job, cause="worker lost")
                return None
            return job_rows.finish(connection, job.id, "failed", error=dict(error))

        return self._store.submit(recover)

    async def tickets(self, lost_seconds: float) -> tuple[list[int], int]:
        """Return the tickets of running jobs of dead workers, and the number of queued jobs without a ticket.

        A worker counts as dead if it has sent no heartbeat for `lost_seconds`.
        """

        def load(connection: Connection) -> tuple[list[int], int]:
            return tickets.lost_tickets(connection, lost_seconds), tickets.count_missing(connection, lost_seconds)

        return await self._in_thread(load)

    def issue_tickets(self, number: int, lost_seconds: float) -> Future[None]:
        """Add tickets to the queue, and delete those of dead workers."""

        def issue(connection: Connection) -> None:
            tickets.delete_dead(connection, lost_seconds)
            tickets.issue(connection, number)

        return self._store.submit(issue)

    # Results; the future has None if the job had ended already, such as by a cancellation

    def complete_shape(self, job: JobRecord, computed: ComputedShape) -> Future[JobRecord | None]:
        """Store the shape of an upload, and end its job."""

        def complete(connection: Connection) -> JobRecord | None:
            shape_rows.lock_shapes(connection)
            if not job_rows.is_current(connection, job):
                return None
            if shape_rows.find_shape(connection, computed.key):  # another process added it meanwhile
                return _complete_known(connection, job, computed.key)
            shape = shape_rows.add_shape(connection, computed, _shape_request(job))
            return job_rows.finish(connection, job.id, "succeeded", shape_id=shape.id, warnings=shape.warnings)

        return self._store.submit(complete)

    def complete_known(self, job: JobRecord, key: UploadKey) -> Future[JobRecord | None]:
        """End the job of an upload whose shape is stored already, or requeue it if the shape was removed meanwhile."""
        return self._store.submit(partial(_complete_known, job=job, key=key))

    def complete_query(self, job: JobRecord, ranking: Ranking) -> Future[JobRecord | None]:
        """Store the ranking of a query, and end its job."""
        return self._finish(job, "succeeded", result=ranking.as_dict(), warnings=ranking.warnings)

    def complete_file(self, job: JobRecord, file: JobFile) -> Future[JobRecord | None]:
        """Store the file of a job, and end the job; NotFoundError if the shape was removed meanwhile."""

        def complete(connection: Connection) -> JobRecord | None:
            shape_rows.lock_shapes(connection)
            shape_rows.get_shape(connection, job.shape_id or "")
            if not job_rows.is_current(connection, job):
                return None
            return job_rows.finish(connection, job.id, "succeeded", shape_id=job.shape_id, file=file)

        return self._store.submit(complete)

    def fail(self, job: JobRecord, error: Mapping[str, Any], reached: Progress | None) -> Future[JobRecord | None]:
        """End a job with an error."""
        return self._finish(job, "failed", error=dict(error), reached=reached)

    def cancel(self, job_id: str, error: Mapping[str, Any], reached: Progress | None) -> Future[JobRecord | None]:
        """Cancel a job."""
        return self._store.submit(
            lambda connection: job_rows.finish(connection, job_id, "cancelled", error=dict(error), reached=reached)
        )

    def _finish(self, job: JobRecord, state: JobState, **values: Any) -> Future[JobRecord | None]:
        return self._store.submit(lambda connection: job_rows.finish(connection, job.id, state, claimed=job, **values))

    # History

    def delete_ended(
        self, *, before: datetime | None = None, keep: int | None = None, owner: str | None = None
    ) -> Future[int]:
        """Delete a batch of ended jobs, as `job_rows.delete_ended` does; return its size."""
        return self._store.submit(partial(job_rows.delete_ended, before=before, keep=keep, owner=owner))

    def delete_files(self, before: datetime) -> Future[None]:
        """Delete the files of jobs that ended before an instant."""
        return self._store.submit(partial(job_rows.delete_files, before=before))

    def schedule_callback(self, job_id: str, attempts: int, due: datetime | None) -> Future[None]:
        """Schedule the next attempt at a job's webhook; `due` is None after the last."""
        return self._store.submit(partial(job_rows.schedule_callback, job_id=job_id, attempts=attempts, due=due))

    # Reads

    async def get(self, job_id: str) -> JobRecord:
        """Return a job; NotFoundError if there is none of this id."""
        return await self._store.fetch(partial(job_rows.get_job, job_id=job_id))

    async def position(self, job: JobRecord) -> int | None:
        """Return the number of jobs that start before a queued job; None if the job is not queued."""
        if job.state != "queued":
            return None
        return await self._store.fetch(partial(job_rows.position, job=job))

    async def is_known(self, key: UploadKey) -> bool:
        """Return whether the shape of an upload is stored already."""
        return await self._store.fetch(partial(shape_rows.find_shape, key=key)) is not None

    async def count_queued(self) -> int:
        """Return the number of queued jobs."""
        return await self._store.fetch(job_rows.count_queued)

    async def running(self) -> list[JobRecord]:
        """Return the jobs that are running in the store."""
        return await self._store.fetch(job_rows.running_jobs)

    async def take_callbacks(self, limit: int, lease: timedelta) -> list[JobRecord]:
        """Return ended jobs whose webhooks are due, the longest due first; no other server takes them for `lease`."""
        now = datetime.now(UTC)
        if not await self._store.fetch(partial(job_rows.has_due_callback, now=now)):
            return []  # without a write, which would wait for the disk
        take = partial(job_rows.take_callbacks, now=now, until=now + lease, limit=limit)
        return await asyncio.wrap_future(self._store.submit(take))

    async def page(self, conditions: JobFilter, *, cursor: str | None, limit: int) -> tuple[JobPage, Mapping[str, int]]:
        """Return what `read_page` returns."""
        return await asyncio.to_thread(partial(self.read_page, conditions, cursor=cursor, limit=limit))

    def read_page(self, conditions: JobFilter, *, cursor: str | None, limit: int) -> tuple[JobPage, Mapping[str, int]]:
        """Return up to `limit` jobs without results, the newest first, and the queue positions by id."""

        def load(connection: Connection) -> tuple[JobPage, Mapping[str, int]]:
            page = job_rows.list_jobs(connection, conditions, cursor=cursor, limit=limit)
            return page, job_rows.positions(connection, page.items)

        return self._store.load(load)

    async def file(self, job: JobRecord) -> JobFile:
        """Return the file of a job; NotFoundError if the job has no file, or the file was deleted."""
        return await self._in_thread(partial(job_rows.get_file, job=job))

    async def _in_thread(self, load: Callable[[Connection], T]) -> T:
        return await asyncio.to_thread(self._store.load, load)


def _check_queue(connection: Connection, sender: Sender, limits: QueueLimits) -> None:
    waiting = job_rows.count_queued(connection)
    if waiting >= limits.queued:
        pause = max(1, waiting // (_CLAIMS_A_SECOND * max(1, limits.workers)))
        raise QueueFullError(f"{waiting} jobs wait already", retry_after=pause)
    if limits.owned is None or not sender.owner:
        return
    lock(connection, f"jobs of {sender.owner}")  # so that servers count each other's
    if job_rows.count_unfinished(connection, sender.owner) >= limits.owned:
        raise QuotaError(f"{limits.owned} jobs of this key wait or run already, as many as the key may have")


class _Attempts:
    """The runs of a submission. All add the same job, because an earlier run may have been committed."""

    def __init__(self) -> None:
        self.job_id = job_rows.new_id()
        self._runs = itertools.count()

    def find_job(self, connection: Connection) -> JobRecord | None:
        """Return the job that an earlier run has added; begins the next run."""
        return job_rows.find_job(connection, self.job_id) if next(self._runs) else None


def _find_sent(connection: Connection, attempts: _Attempts, sender: Sender) -> JobRecord | NewJob | None:
    """Return the job of an earlier run of this change, or of an earlier request with the same idempotency key."""
    if sent := attempts.find_job(connection):
        return NewJob(sent)
    if not sender.idempotency:
        return None
    lock(connection, f"request {sender.idempotency}")  # so that servers see each other's
    earlier = job_rows.find_sent(connection, sender.idempotency, datetime.now(UTC) - IDEMPOTENCY)
    if earlier and earlier.fingerprint != sender.fingerprint:
        raise IdempotencyError("a different request was sent with this Idempotency-Key")
    return earlier


def _shape_request(job: JobRecord) -> ShapeRequest:
    if not isinstance(job.request, ShapeRequest):
        raise TypeError(f"job {job.id} is not an upload")
    return job.request


def _complete_known(connection: Connection, job: JobRecord, key: UploadKey) -> JobRecord | None:
    shape_rows.lock_shapes(connection)
    if not job_rows.is_current(connection, job):
        return None
    known = shape_rows.find_shape(connection, key)
    if known is None:
        job_rows.requeue(connection, job, cause="shape removed")
        return None
    updated = shape_rows.update_known(connection, known, _shape_request(job))
    return job_rows.finish(
        connection, job.id, "succeeded", shape_id=known.id, warnings=known.warnings, ignored=updated.ignored
    )


__all__ = ["ANONYMOUS", "JobFilter", "Jobs", "NewJob", "QueueLimits", "Sender"]
