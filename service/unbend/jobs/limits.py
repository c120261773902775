"""Limits on jobs, their processes and the queue."""

from __future__ import annotations

import contextlib
import os
import resource
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import scipy.linalg  # noqa: F401  loaded before its threads, and NumPy's, are limited
from threadpoolctl import threadpool_limits

from unbend.mesh.limits import MeshLimits

MESH_LIMITS: Final = MeshLimits(vertices=2_000_000, faces=4_000_000)

_NICE: Final = 5
"""Niceness of workers, so that the server responds while all cores compute."""

_OOM_SCORE: Final = "500"
"""Score for the system's out-of-memory killer, so that it kills a worker before the server."""


@dataclass(frozen=True)
class JobLimits:
    """Limits on jobs and the queue."""

    seconds: float = 600.0
    """Longest time of a job."""
    memory_mb: int | None = 8192
    """Address space of a worker, in megabytes; None for no limit."""
    queued: int = 10_000
    """Maximum number of queued jobs."""
    attempts: int = 2
    """Maximum number of attempts at a job whose process dies."""
    restarts: int = 10
    """Maximum number of restarts of a job whose server dies. There is a limit, because the job may kill the server."""
    drain_seconds: float = 20.0
    """Longest time for which a stopping server waits for running jobs."""
    call_seconds: float = 60.0
    """Longest time of a call without the queue, including its wait."""
    calls: int = 32
    """Maximum number of waiting and running calls in a lane."""
    mesh: MeshLimits = MESH_LIMITS
    """Maximum numbers of vertices and faces of a mesh."""
    history: int = 100_000
    """Maximum number of stored jobs that have ended."""
    history_days: float = 0.0
    """Maximum number of days for which an ended job is stored; 0 for no limit."""


def limit_process(memory_bytes: int | None) -> None:
    """Limit a worker to one thread and to its memory, and lower its priority."""
    threadpool_limits(1)  # the pool has one process for each core
    with contextlib.suppress(OSError):
        os.nice(_NICE)
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(_OOM_SCORE)
    if memory_bytes:
        with contextlib.suppress(ValueError, OSError):  # some systems cannot limit address space
            resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, memory_bytes))
