"""What one job, its process, and the queue may take."""

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
"""The server answers while all cores compute: the system is told whose turn comes first."""

_FIRST_TO_GO: Final = "500"
"""Where the machine runs out of memory the system ends a worker before the server, which would lose them all."""


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
    call_seconds: float = 60.0
    """That a call past the queue may take, waiting included."""
    calls: int = 32
    """Calls past the queue that may wait."""
    mesh: MeshLimits = MESH_LIMITS
    history: int = 100_000
    """Jobs that have ended and are kept."""
    history_days: float = 0.0
    """Days that a job is kept after its end; 0 for no limit."""


def limit_process(memory_bytes: int | None) -> None:
    """Prepare a worker: one thread for each library, no more memory than allowed."""
    threadpool_limits(1)  # the pool has a process for every core
    with contextlib.suppress(OSError):
        os.nice(_NICE)
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(_FIRST_TO_GO)
    if memory_bytes:
        with contextlib.suppress(ValueError, OSError):  # systems that do not limit address space
            resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, memory_bytes))
