"""Work on many items in threads. Kernels release the GIL, so that the threads run in parallel."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numpy as np

from unbend.errors import ParameterError

Progress = Callable[[float], None]
"""Callback that receives the share of the work that is done, 0 to 1."""

_PARTS_PER_THREAD = 8  # enough to balance slow items and to report progress


def available_cores() -> int:
    """Return the number of cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def check_threads(threads: int | None) -> int:
    """Return `threads`, by default one for each available core; ParameterError if it is below 1."""
    if threads is not None and threads < 1:
        raise ParameterError(f"threads must be at least 1, not {threads}")
    return threads or available_cores()


def share_out(count: int, threads: int | None, work: Callable[[slice], None], progress: Progress | None = None) -> None:
    """Divide `count` items into slices, and call `work` on each slice; every free thread takes the next slice."""

    def run(part: slice) -> int:
        work(part)
        return int(part.stop)

    workers = max(1, min(check_threads(threads), count))
    parts = _parts(count, workers)
    if workers == 1:
        _wait_for(map(run, parts), count, progress)
    else:
        with ThreadPoolExecutor(workers) as pool:
            _wait_for(pool.map(run, parts), count, progress)


def _parts(count: int, workers: int) -> list[slice]:
    bounds = np.linspace(0, count, min(count, _PARTS_PER_THREAD * workers) + 1).astype(int)
    return [slice(int(start), int(stop)) for start, stop in pairwise(bounds)]


def _wait_for(stops: Iterator[int], total: int, progress: Progress | None) -> None:
    for stop in stops:
        if progress:
            progress(stop / total)
