"""The pool of worker processes: spawned, limited, replaced when one dies."""

from __future__ import annotations

import asyncio
import logging
import multiprocessing
from collections.abc import Callable
from concurrent.futures.process import BrokenProcessPool
from typing import TypeVar

from pebble import ProcessExpired, ProcessPool

from unbend.jobs.worker import initialise, warm_up

logger = logging.getLogger("unbend.jobs")
T = TypeVar("T")

_WARM_UP_ATTEMPTS = 3
_WARM_UP_SECONDS = 600.0  # the first time on a machine every kernel is compiled


class WorkerPool:
    """Processes that compute tasks; one that dies takes only its own task with it.

    Spawned, not forked: the server has threads. Should the pool itself break, a new one takes its place.
    """

    def __init__(self, workers: int, memory_mb: int | None) -> None:
        self._workers = workers
        self._memory = None if memory_mb is None else memory_mb * 2**20
        self._pool = self._make()

    async def warm_up(self) -> None:
        """Have every process load its kernels."""
        try:
            await asyncio.gather(*(self._warm_up_one() for _ in range(self._workers)))
        except Exception:
            logger.exception("the worker processes cannot be started")
            raise

    async def _warm_up_one(self) -> None:
        for attempt in range(_WARM_UP_ATTEMPTS):
            try:
                await self.call(warm_up, (), _WARM_UP_SECONDS)
            except ProcessExpired:
                if attempt + 1 == _WARM_UP_ATTEMPTS:
                    raise
            else:
                return

    async def call(self, function: Callable[..., T], arguments: tuple[object, ...], seconds: float) -> T:
        """Run `function` in a process; cancelling this stops the process.

        Raises
        ------
        TimeoutError
            If it ran longer than `seconds`; its process is stopped.
        ProcessExpired
            If its process died.
        Exception
            Whatever the function raises.
        """
        pool = self._pool
        try:
            result: T = await asyncio.wrap_future(pool.schedule(function, args=arguments, timeout=seconds))
        except (BrokenProcessPool, RuntimeError) as error:
            if pool.active:
                raise
            self._replace(pool)
            raise ProcessExpired("the pool of processes broke", code=-1, pid=0) from error
        return result

    def stop(self) -> None:
        """End all processes, whatever they do."""
        self._pool.stop()
        self._pool.join()

    def _make(self) -> ProcessPool:
        return ProcessPool(
            max_workers=self._workers,
            initializer=initialise,
            initargs=(self._memory,),
            context=multiprocessing.get_context("spawn"),
        )

    def _replace(self, broken: ProcessPool) -> None:
        if self._pool is broken:
            logger.error("the pool of processes broke; starting another")
            broken.stop()
            self._pool = self._make()
