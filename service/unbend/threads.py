"""Work on many items in threads. Kernels release the GIL, so that the threads run in parallel."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from itertools import pairwise
from typing import Any, Final, Self

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


class Team:
    """Threads that share one task after another; the calling thread is one of them.

    The other threads start once. They help only while a processor is free for them: the calling thread takes whatever
    they have not begun, so that help never delays a task.

    Parameters
    ----------
    threads : int
        At least 1, with the calling thread.
    """

    def __init__(self, threads: int) -> None:
        self.threads = threads
        self._helpers = ThreadPoolExecutor(threads - 1) if threads > 1 else None  # starts each thread when it is needed

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._helpers:
            self._helpers.shutdown()

    def share_out(self, count: int, work: Callable[[slice], None], progress: Progress | None = None) -> None:
        """Divide `count` items into slices, and call `work` on each slice; every free thread takes the next slice."""
        parts = _parts(count, min(self.threads, count))
        left, done = iter(parts), [0]  # the next item of an iterator goes to one thread only

        def help_out() -> None:
            for part in left:
                work(part)
                done.append(part.stop - part.start)

        helpers = [self._helpers.submit(help_out) for _ in parts[1 : self.threads]] if self._helpers else []
        try:
            for part in left:
                work(part)
                done.append(part.stop - part.start)
                if progress:
                    progress(sum(done) / count)
        finally:
            for _ in left:  # nobody begins another slice after an error
                pass
            for helper in helpers:
                if not helper.cancel():
                    helper.result()
        if progress and parts:
            progress(1.0)


_LARGE: Final = 1000
"""Rows of a matrix for which several threads of BLAS are worth their wait for each other."""

_LIMIT_LOCK: Final = threading.Lock()
_limits: list[Any] = []
"""The limit that is in force, once for each user of `one_blas_thread`."""


@contextmanager
def one_blas_thread(size: int = 0) -> Iterator[None]:
    """Within this context, let BLAS use one thread unless matrices have many rows; then restore the caller's setting.

    The threads of BLAS wait for each other by spinning. Beside other work on the same processors, that takes small
    matrices many times as long as the arithmetic does. The setting is one for the whole process.
    """
    if size >= _LARGE:
        yield
        return
    with _LIMIT_LOCK:
        _limits.append(_limits[0] if _limits else _blas().limit(limits=1, user_api="blas"))
    try:
        yield
    finally:
        with _LIMIT_LOCK:
            limit = _limits.pop()
            if not _limits:
                limit.restore_original_limits()


@cache
def _blas() -> Any:
    from threadpoolctl import ThreadpoolController  # noqa: PLC0415  importing and searching takes milliseconds

    return ThreadpoolController()


def share_out(count: int, threads: int | None, work: Callable[[slice], None], progress: Progress | None = None) -> None:
    """Share out the items of one task, as `Team.share_out` does, on `threads` threads, by default one for each core."""
    with Team(max(1, min(check_threads(threads), count))) as team:
        team.share_out(count, work, progress)


def _parts(count: int, workers: int) -> list[slice]:
    bounds = np.linspace(0, count, min(count, _PARTS_PER_THREAD * workers) + 1).astype(int)
    return [slice(int(start), int(stop)) for start, stop in pairwise(bounds)]
