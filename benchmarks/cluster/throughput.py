"""Jobs a second through the queue of a cluster, without their computations and with them.

    python -m benchmarks.cluster.throughput [JOBS UPLOADS]

Writes the section "queue" of docs/benchmarks/cluster.md. In the first table, each job goes the whole way of a query: an
upload is stored and queued in one transaction, PostgreSQL announces a ticket, a worker claims the job, the end is
stored, and the news of it arrives. Only the computation is missing. Workers are processes of their own; this process
submits the jobs. All share the cores of this machine with PostgreSQL.

In the second table, meshes of 1,040 vertices are sent to a server over HTTP, and computed without local signatures by
one or two workers of one process each. Beside it, the same files are computed by one and two processes without any
service.
"""

from __future__ import annotations

import asyncio
import logging
import multiprocessing
import os
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, suppress
from functools import partial
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Final

import psutil
from threadpoolctl import threadpool_limits

from benchmarks.common import ROOT, table, write_section
from tests.support.postgres import Postgres, running_postgres
from tests.support.server import Server, Worker, ply, post_mesh, stored
from unbend import Library, Parameters, compute_signature, read_mesh
from unbend.jobs.execution import Execution
from unbend.jobs.limits import JobLimits
from unbend.jobs.runner import JobRunner
from unbend.library.records import JobRecord
from unbend.library.requests import QueryRequest, Upload
from unbend.mesh.shapes import torus
from unbend.results.rankings import Ranking

PAGE: Final = ROOT / "docs" / "benchmarks" / "cluster.md"

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


def through_the_queue(jobs: int) -> list[list[object]]:
    """Return rows of the first table."""
    rows: list[list[object]] = []
    with running_postgres() as postgres:
        url = postgres.new()
        Library(url).close()
        context = multiprocessing.get_context("spawn")
        for number in (1, 2):
            stop = context.Event()
            workers = [context.Process(target=work, args=(url, stop)) for _ in range(number)]
            for worker in workers:
                worker.start()
            time.sleep(8.0)  # until the workers wait for tickets
            before = cpu_seconds_of(postgres)
            submitted, ended = asyncio.run(measure(url, jobs))
            used = cpu_seconds_of(postgres) - before
            stop.set()
            for worker in workers:
                worker.join()
            rows.append([number, f"{jobs / submitted:.0f}", f"{jobs / ended:.0f}", f"{1000 * used / jobs:.1f}"])
    return rows


def cpu_seconds_of(postgres: Postgres) -> float:
    """Return the processor time of the server's present processes."""
    used = 0.0
    for each in psutil.Process(postgres.pid).children(recursive=True):
        with suppress(psutil.NoSuchProcess):  # it ended just now
            times = each.cpu_times()
            used += times.user + times.system
    return used


def real_jobs(uploads: int) -> list[list[object]]:
    """Return rows of the second table."""
    rows: list[list[object]] = []
    for number in (1, 2):
        spawn = multiprocessing.get_context("spawn")
        # One thread each, as workers have.
        with ProcessPoolExecutor(number, spawn, threadpool_limits, (1,)) as processes:
            list(processes.map(compute, range(number * 2)))  # which loads the kernels
            begun = time.perf_counter()
            list(processes.map(compute, range(uploads)))
            bare = uploads / (time.perf_counter() - begun)
        rows.append([number, f"{bare:.1f}", f"{over_http(number, uploads):.1f}"])
    return rows


def mesh(number: int) -> bytes:
    return ply(torus(minor=0.2 + 0.0001 * number, columns=40, rows=26))


def compute(number: int) -> None:
    compute_signature(read_mesh(mesh(number)), threads=1)


def over_http(workers: int, uploads: int) -> float:
    """Return the uploads a second that a cluster completes."""
    with ExitStack() as stack:
        postgres = stack.enter_context(running_postgres())
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        url = postgres.new()
        server = stack.enter_context(Server(folder / "server", library=url, workers=0))
        for number in range(workers):
            stack.enter_context(Worker(folder / f"worker-{number}", library=url, workers=1))
        http = stack.enter_context(server.http())
        stored(http, mesh(uploads))  # which warms up
        files = [mesh(number) for number in range(uploads)]
        begun = time.perf_counter()
        places = [post_mesh(http, data).headers["Location"] for data in files]
        for place in places:
            while http.get(place, params={"wait": 30}).json()["state"] in {"queued", "running"}:
                pass
        return uploads / (time.perf_counter() - begun)


def main() -> None:
    jobs, uploads = (int(each) for each in (sys.argv[1:] or ("3000", "200")))
    queue = table(["workers", "submitted a second", "through the queue a second", "PostgreSQL, ms a job"],
                  through_the_queue(jobs))  # fmt: skip
    real = table(["workers or processes", "bare processes", "the cluster"], real_jobs(uploads))
    load = f"The load of the last minute at the end was {os.getloadavg()[0]:.1f}, with the benchmark's own."
    write_section(PAGE, "queue", f"""\
Without computations, {jobs} jobs; each worker runs {SLOTS + 1} at a time. {load}

{queue}

With computations, {uploads} uploads, files a second:

{real}
""")  # fmt: skip


if __name__ == "__main__":
    main()
