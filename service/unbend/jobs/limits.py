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
"""Niceness of workers: the server must respond while all cores compute."""

_OOM_SCORE: Final = "500"
"""Score for the system's out-of-memory killer: it must kill a worker before the server."""


@dataclass(frozen=True)
class JobLimits:
    """Limits on jobs and the queue."""

    seconds: float = 600.0
    """Time of a job."""
    memory_mb: int | None = 8192
    """Address space of a worker, in megabytes; None for no limit."""
    queued: int = 10_000
    """Queued jobs."""
    attempts: int = 2
    """Attempts at a job whose process dies."""
    restarts: int = 10
    """Restarts of a job whose server dies. Few jobs kill a server, but some may."""
    drain_seconds: float = 20.0
    """Time that a stopping server gives running jobs."""
    call_seconds: float = 60.0
    """Time of a call without the queue, including its wait."""
    calls: int = 32
    """Waiting and running calls in a lane."""
    mesh: MeshLimits = MESH_LIMITS
    """Vertices and faces of a mesh."""
    history: int = 100_000
    """Stored jobs that have ended."""
    history_days: float = 0.0
    """Days that an ended job is stored; 0 for no limit."""


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
