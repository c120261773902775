"""Prometheus metrics of a server. Every label has few values, whatever clients request."""

from __future__ import annotations

import asyncio
import contextlib
import shutil
import tempfile
from collections.abc import AsyncIterator, Mapping
from typing import Final

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, Info, ProcessCollector, generate_latest

from unbend import __version__
from unbend.errors import StoreError, StoreUnavailableError
from unbend.jobs.observer import NoObserver
from unbend.jobs.runner import JobRunner
from unbend.library import Library
from unbend.library.records import JobRecord

_JOB_BUCKETS: Final = (0.05, 0.1, 0.25, 0.5, 1, 2.5, 5, 10, 30, 60, 120, 300, 600)
_HTTP_BUCKETS: Final = (0.001, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1, 2.5, 5, 10, 30, 60)


class Metrics(NoObserver):
    """The metrics of one application, in their own registry; a `JobObserver`; thread-safe."""

    def __init__(self) -> None:
        self.registry = registry = CollectorRegistry()
        ProcessCollector(registry=registry)
        Info("unbend_build", "The running version", registry=registry).info({"version": __version__})
        self._queued = Gauge("unbend_jobs_queued", "Queued jobs", registry=registry)
        self._running = Gauge("unbend_jobs_running", "Claimed jobs", registry=registry)
        self._workers = Gauge("unbend_workers", "Worker processes", registry=registry)
        self._shapes = Gauge("unbend_library_shapes", "Shapes of the library", registry=registry)
        self._streams = Gauge("unbend_event_streams", "Open streams of job events", registry=registry)
        self._writable = Gauge("unbend_library_writable", "1 if uploads can be stored, else 0", registry=registry)
        self._free = Gauge("unbend_disk_free_bytes", "Free bytes of a disk", ["disk"], registry=registry)
        self._backup = Gauge("unbend_backup_timestamp_seconds", "Time of the last backup", registry=registry)
        self._backup_failures = Counter("unbend_backup_failures", "Failed backups", registry=registry)
        self._jobs = Counter(
            "unbend_jobs", "Ended jobs, by code of the error", ["kind", "outcome", "code"], registry=registry
        )
        self._job_seconds = Histogram(
            "unbend_job_seconds", "Time from the start of a job to its end", ["kind", "outcome"],
            buckets=_JOB_BUCKETS, registry=registry,
        )  # fmt: skip
        self._wait_seconds = Histogram(
            "unbend_job_wait_seconds", "Time from the submission of a job to its start", ["kind"],
            buckets=_JOB_BUCKETS, registry=registry,
        )  # fmt: skip
        self._stage_seconds = Histogram(
            "unbend_stage_seconds", "Time of one stage of a computation", ["stage"],
            buckets=_JOB_BUCKETS, registry=registry,
        )  # fmt: skip
        self._http_seconds = Histogram(
            "unbend_http_request_seconds", "Time to the head of a response", ["method", "route", "status"],
            buckets=_HTTP_BUCKETS, registry=registry,
        )  # fmt: skip

    def ended(self, job: JobRecord) -> None:
        """Count a job that has ended."""
        code = job.error["code"] if job.error else ""
        self._jobs.labels(job.kind, job.state, code).inc()
        if job.started_at and job.finished_at:
            self._job_seconds.labels(job.kind, job.state).observe((job.finished_at - job.started_at).total_seconds())
            self._wait_seconds.labels(job.kind).observe((job.started_at - job.created_at).total_seconds())

    def computed(self, seconds: Mapping[str, float]) -> None:
        """Record the times of the stages of a computation."""
        for stage, taken in seconds.items():
            self._stage_seconds.labels(stage).observe(taken)

    def backed_up(self, at: float) -> None:
        """Record the time of the last backup, in seconds since 1970; 0 for never."""
        self._backup.set(at)

    def backup_failed(self) -> None:
        """Count a failed backup."""
        self._backup_failures.inc()

    def answered(self, method: str, route: str, status: int, seconds: float) -> None:
        """Record a response; `route` is the template of its path."""
        self._http_seconds.labels(method, route, str(status)).observe(seconds)

    async def counted_stream(self, stream: AsyncIterator[str]) -> AsyncIterator[str]:
        """Pass a stream on, and count it while it is open."""
        with self._streams.track_inprogress():
            async for part in stream:
                yield part

    async def text(self, runner: JobRunner, library: Library) -> bytes:
        """Return all metrics, after updating those of the queue, the library and the disks."""
        self._running.set(runner.running)
        self._workers.set(runner.workers)
        with contextlib.suppress(StoreUnavailableError):  # counters are needed most while the database is down
            self._queued.set(await runner.queued())
            self._shapes.set(await asyncio.to_thread(len, library))
        await asyncio.to_thread(self._update_disks, library)
        return await asyncio.to_thread(generate_latest, self.registry)

    def _update_disks(self, library: Library) -> None:
        self._free.labels("temporary").set(shutil.disk_usage(tempfile.gettempdir()).free)
        if library.disk:
            self._free.labels("library").set(library.disk.free())
        try:
            library.check_writable()
        except StoreError:
            self._writable.set(0)
        else:
            self._writable.set(1)
