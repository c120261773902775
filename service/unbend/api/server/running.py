"""The start and stop of a server's parts, around the time in which it serves."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING

from unbend.api.server.metrics import Metrics
from unbend.api.server.object_sweeps import ObjectSweeps
from unbend.api.server.opening import open_library
from unbend.api.server.scheduled_backups import ScheduledBackups
from unbend.api.server.service import Service
from unbend.api.server.settings import Settings
from unbend.api.server.vector_upkeep import VectorUpkeep
from unbend.api.server.wait_limit import WaitLimit
from unbend.api.server.webhooks import Webhooks
from unbend.jobs.observer import Observers
from unbend.jobs.runner import JobRunner
from unbend.library.request_rates import SharedRateLimit
from unbend.library.storage.lease import Lease

if TYPE_CHECKING:
    from unbend.api.server.traces import Traces


@asynccontextmanager
async def running_service(
    settings: Settings, metrics: Metrics, traces: Traces | None, lease: Lease | None = None
) -> AsyncIterator[Service]:
    """Open the library, and start the jobs, webhooks and backups; stop them at the end.

    Parameters
    ----------
    settings : Settings
    metrics : Metrics
    traces : Traces, optional
        Closed at the end.
    lease : Lease, optional
        The lease of the library; by default acquired here, which raises StoreInUseError if another server has it.
    """
    own_lease = lease or Lease(settings.library)
    library = open_library(settings)
    if library.disk:
        library.disk.reserve(settings.reserve_bytes)
    runner = JobRunner(
        library,
        workers=settings.workers,
        limits=settings.limits,
        observer=Observers(metrics, traces) if traces else metrics,
        with_parts=settings.local_signatures,
    )
    scheduled = ScheduledBackups(library, settings.backup_plan, metrics) if settings.backup_plan else None
    webhooks = Webhooks(library.jobs, settings.webhook_plan) if settings.webhook_plan else None
    rates = SharedRateLimit(library.store, settings.requests_per_minute) if library.store.postgres else None
    await runner.start()
    has_vectors = library.store.postgres and settings.search != "memory"
    vectors = VectorUpkeep(library, settings.search) if has_vectors else None
    sweeps = ObjectSweeps(library) if settings.objects else None
    background = [each for each in (scheduled, webhooks, vectors, sweeps) if each]
    for each in background:
        each.start()
    try:
        yield Service(settings, library, runner, metrics, WaitLimit(settings.max_waiting), rates)
    finally:
        for each in background:
            await each.stop()
        await runner.stop()
        library.close()
        own_lease.close()
        if traces:
            await asyncio.to_thread(traces.close)


def open_traces(endpoint: str) -> Traces | None:
    """Return the traces for a collector at `endpoint`; None without one."""
    if not endpoint:
        return None
    from unbend.api.server.traces import Traces  # noqa: PLC0415  packages of an extra

    return Traces(endpoint)
