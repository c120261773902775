"""The pool of worker processes. Each process has limits, and is replaced when it dies."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, Final, TypeVar

from unbend.errors import JobTimeoutError, WorkerLostError
from unbend.geodesics.marching import march
from unbend.jit import is_compiled
from unbend.jobs.process import Listener, WorkerProcess
from unbend.jobs.worker import initialise

logger = logging.getLogger("unbend.jobs")
T = TypeVar("T")

_START_ATTEMPTS: Final = 3


class WorkerPool:
    """Worker processes. A process that dies loses only its own task. Used within one event loop.

    Parameters
    ----------
    workers : int
        Number of processes; 0 for a server whose jobs run elsewhere.
    memory_mb : int or None
        Address space of each process, in megabytes; None for no limit.
    """

    def __init__(self, workers: int, memory_mb: int | None) -> None:
        self.size = workers
        memory = None if memory_mb is None else memory_mb * 2**20
        self._workers = [WorkerProcess(partial(initialise, memory, number)) for number in range(workers)]
        self._threads = ThreadPoolExecutor(max(1, workers), thread_name_prefix="unbend worker")
        self._free: asyncio.LifoQueue[WorkerProcess] = asyncio.LifoQueue()
        for worker in self._workers:
            self._free.put_nowait(worker)

    async def start(self) -> None:
        """Start every process, and wait until all are ready."""
        if self._workers and not is_compiled(march):
            logger.warning("compiling the kernels, once for this machine: jobs wait about a minute")
        try:
            await asyncio.gather(*(self._start_one() for _ in self._workers))
        except Exception:
            logger.exception("the worker processes cannot be started")
            raise

    async def _start_one(self) -> None:
        for attempt in range(_START_ATTEMPTS):
            try:
                await self.call(_do_nothing, (), math.inf)
            except WorkerLostError:
                if attempt + 1 == _START_ATTEMPTS:
                    raise
            else:
                return

    async def call(
        self,
        function: Callable[..., T],
        arguments: tuple[object, ...],
        seconds: float,
        listener: Listener | None = None,
    ) -> T:
        """Run `function` in the next free process; cancelling this call kills the process.

        Parameters
        ----------
        function, arguments
            Pickled, as is the result.
        seconds : float
            Longest time of the run, measured from when the process has accepted the function.
        listener : callable, optional
            Called, in a thread, with each message that the function sends.

        Raises
        ------
        JobTimeoutError
            If the function ran longer than `seconds`; its process is killed.
        WorkerLostError
            If the process died.
        Exception
            Whatever the function raises.
        """
        worker = await self._free.get()
        worker.prepare()
        loop = asyncio.get_running_loop()
        deadline = _Deadline(worker, seconds)

        def accepted() -> None:
            loop.call_soon_threadsafe(deadline.begin)

        running = loop.run_in_executor(self._threads, worker.run, function, arguments, listener, accepted)
        running.add_done_callback(deadline.end)
        # The worker is free again only when its thread has finished, even if the caller no longer waits.
        running.add_done_callback(partial(self._release, worker))
        try:
            return await asyncio.shield(running)
        except asyncio.CancelledError:
            if not running.done():
                worker.kill()
            raise
        except WorkerLostError:
            if deadline.expired:
                raise JobTimeoutError(f"the job ran longer than {seconds:g} seconds") from None
            raise

    def _release(self, worker: WorkerProcess, running: asyncio.Future[Any]) -> None:
        if not running.cancelled():
            running.exception()  # retrieved, so that asyncio does not warn about an unretrieved exception
        self._free.put_nowait(worker)

    def stop(self) -> None:
        """Kill all processes."""
        for worker in self._workers:
            worker.end()
        self._threads.shutdown()


class _Deadline:
    """A timer that kills a worker after its time."""

    def __init__(self, worker: WorkerProcess, seconds: float) -> None:
        self.expired = False
        self._worker = worker
        self._seconds = seconds
        self._timer: asyncio.TimerHandle | None = None
        self._ended = False

    def begin(self) -> None:
        if not self._ended and self._seconds < math.inf:
            self._timer = asyncio.get_running_loop().call_later(self._seconds, self._expire)

    def end(self, _running: asyncio.Future[Any]) -> None:
        self._ended = True
        if self._timer:
            self._timer.cancel()

    def _expire(self) -> None:
        self.expired = True
        self._worker.kill()


def _do_nothing() -> None:
    """Do nothing: the call returns as soon as the process is ready."""
