"""Kills servers and workers of a cluster at random, and stops its database, while clients upload meshes.

    python -m benchmarks.cluster.chaos [--kills 50] [--stops 10] [--seed 1]

Two servers without workers, three workers with one process each, and PostgreSQL run on this machine. Clients upload
different meshes, half of them twice, to either server with an idempotency key. They repeat a request until it is
acknowledged, and then follow its job at the other server. Writes the section "cluster" of docs/reliability.md, and
exits with status 1 if there was a fault.
"""

from __future__ import annotations

import argparse
import itertools
import random
import sys
import threading
import time
import uuid
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import httpx

from benchmarks.common import ROOT, table, write_section
from tests.support.postgres import Postgres, running_postgres
from tests.support.server import Server, Worker, small_mesh
from unbend import Library
from unbend.jobs.cluster.dispatcher import LOST_SECONDS

PAGE: Final = ROOT / "docs" / "reliability.md"

CLIENTS: Final = 6
BOUND: Final = LOST_SECONDS + 15
"""Seconds in which the job of a dead worker must run again: two searches after the last heartbeat counts as old."""

QUIET: Final = 150.0
"""Longest time from the last disturbance to the end of all jobs, with the starts of processes on a busy machine."""


@dataclass
class Account:
    """The answers that clients got, and the faults; thread-safe by the interpreter's lock."""

    acknowledged: dict[str, int] = field(default_factory=dict)
    """The mesh of each acknowledged job, by the job's address."""
    known: Counter[int] = field(default_factory=Counter)
    """Uploads answered by a stored shape."""
    answers: Counter[str] = field(default_factory=Counter)
    faults: list[str] = field(default_factory=list)


class Cluster:
    """The processes of a cluster, which can be killed and started again."""

    def __init__(self, folder: Path, library: str) -> None:
        self._folder = folder
        self._library = library
        self._numbers = itertools.count()
        makers = [self.new_server] * 2 + [self.new_worker] * 3
        with ThreadPoolExecutor() as threads:
            started = list(threads.map(lambda make: make(), makers))
        self.servers, self.workers = started[:2], started[2:]

    def new_server(self) -> Server:
        return Server(self._place(), library=self._library, workers=0, drain_seconds=1)

    def new_worker(self) -> Server:
        return Worker(self._place(), library=self._library, workers=1, drain_seconds=1, ready=False)

    def kill(self, chosen: random.Random) -> str:
        """Kill a server or a worker, start another in its place, and return which kind it was."""
        kind = chosen.choices(["server", "worker"], [1, 3])[0]
        processes, make = (self.servers, self.new_server) if kind == "server" else (self.workers, self.new_worker)
        place = chosen.randrange(len(processes))
        processes[place].kill()
        processes[place].stop()  # and its processes, which end by themselves
        processes[place] = make()
        return kind

    def stop(self) -> None:
        for each in (*self.servers, *self.workers):
            each.stop()

    def _place(self) -> Path:
        return self._folder / str(next(self._numbers))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--stops", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    with TemporaryDirectory() as folder, running_postgres() as postgres:
        text, faults = disturb(Path(folder), postgres, asked.kills, asked.stops, asked.seed)
    print(text)
    for fault in faults:
        print(fault, file=sys.stderr)
    write_section(PAGE, "cluster", text)
    sys.exit(bool(faults))


def disturb(folder: Path, postgres: Postgres, kills: int, stops: int, seed: int) -> tuple[str, list[str]]:
    """Run a cluster, disturb it, and return the section of the page and the faults."""
    library = postgres.new()
    Library(library).close()
    cluster, account, chosen = Cluster(folder, library), Account(), random.Random(seed)  # noqa: S311
    events = ["kill"] * kills + ["stop"] * stops
    chosen.shuffle(events)
    done: Counter[str] = Counter()
    try:
        with uploading(cluster, account):
            for number, event in enumerate(events):
                time.sleep(chosen.uniform(0.3, 3.0))
                if event == "kill":
                    done[cluster.kill(chosen)] += 1
                else:
                    postgres.stop()
                    time.sleep(chosen.uniform(0.5, 4.0))
                    postgres.start()
                    done["stop"] += 1
                print(f"{number + 1} of {len(events)}: {event}; {dict(account.answers)}", file=sys.stderr, flush=True)
        begun = time.monotonic()
        with Library(library) as opened:
            states = wait_for_all(opened, account)
            quiet = time.monotonic() - begun
            check(opened, account, states, quiet)
            longest = longest_wait(opened)
            if longest > BOUND:
                account.faults.append(f"a job waited {longest:.0f} s for an attempt")
    finally:
        cluster.stop()
    return section(done, account, states, quiet, longest, seed), account.faults


@contextmanager
def uploading(cluster: Cluster, account: Account) -> Iterator[None]:
    """Upload meshes in several threads while the body runs."""
    stop, numbers = threading.Event(), itertools.count()
    with ThreadPoolExecutor(CLIENTS) as threads:
        clients = [threads.submit(upload_all, cluster, account, stop, numbers) for _ in range(CLIENTS)]
        try:
            yield
        finally:
            stop.set()
        for client in clients:
            client.result()


def upload_all(cluster: Cluster, account: Account, stop: threading.Event, numbers: Iterator[int]) -> None:
    while not stop.is_set():
        number = next(numbers)
        mesh = number // 2 if number % 4 < 2 else number  # half of the meshes are sent twice
        key = uuid.uuid4().hex

        def send(http: httpx.Client, mesh: int = mesh, key: str = key) -> httpx.Response:
            return http.post(
                "/v1/shapes",
                files={"file": ("a.ply", small_mesh(mesh))},
                data={"name": str(mesh), "parameters": '{"samples": 40}'},
                headers={"Idempotency-Key": key},
            )

        response = until_answered(cluster, account, number % 2, send)
        if response.status_code == httpx.codes.OK:
            account.known[mesh] += 1
            continue
        place = response.headers["Location"]
        account.acknowledged[place] = mesh
        until_answered(
            cluster, account, (number + 1) % 2, lambda http, place=place: http.get(place, params={"wait": 5})
        )


def until_answered(
    cluster: Cluster, account: Account, server: int, send: Callable[[httpx.Client], httpx.Response]
) -> httpx.Response:
    """Repeat a request until a server answers it, each time at the other server."""
    for attempt in itertools.count():
        try:
            with httpx.Client(base_url=cluster.servers[(server + attempt) % 2].url, timeout=60.0) as http:
                response = send(http)
        except httpx.TransportError:
            account.answers["no answer"] += 1
            time.sleep(0.2)
            continue
        if response.status_code == httpx.codes.SERVICE_UNAVAILABLE and "Retry-After" in response.headers:
            account.answers["503 with Retry-After"] += 1
            time.sleep(float(response.headers["Retry-After"]) / 4)
            continue
        account.answers[str(response.status_code)] += 1
        if not response.is_success:
            account.faults.append(
                f"{response.request.method} {response.request.url}: {response.status_code} {response.text}"
            )
        return response
    raise AssertionError


def wait_for_all(library: Library, account: Account) -> Counter[str]:
    """Wait until no job waits or runs; return the number of acknowledged jobs in each state."""
    deadline = time.monotonic() + QUIET
    while time.monotonic() < deadline:
        if not any(library.list_jobs(state=state, limit=1) for state in ("queued", "running")):
            break
        time.sleep(0.2)
    states: Counter[str] = Counter()
    with library.store.read() as connection:
        rows = connection.exec_driver_sql("SELECT id, state, error::text, attempts FROM jobs").all()
    found = {row.id: row for row in rows}
    for place in account.acknowledged:
        row = found.get(place.rpartition("/")[2])
        states[row.state if row else "lost"] += 1
        if row is None or row.state != "succeeded":
            account.faults.append(f"{place}: {row.state + ' ' + str(row.error) if row else 'lost'}")
    return states


def check(library: Library, account: Account, states: Counter[str], quiet: float) -> None:
    """Note what is missing or there twice."""
    meshes = Counter(shape.name for shape in library)
    sent = {str(mesh) for mesh in (*account.acknowledged.values(), *account.known)}
    account.faults.extend(f"mesh {mesh} has {count} shapes" for mesh, count in meshes.items() if count > 1)
    account.faults.extend(f"mesh {mesh} was acknowledged, but has no shape" for mesh in sent - set(meshes))
    if quiet > QUIET - 1:
        account.faults.append(f"after {quiet:.0f} s jobs still wait or run: {dict(states)}")


def longest_wait(library: Library) -> float:
    """Return the longest time from the submission of a job to the start of its last attempt, for each of its attempts.

    A job whose worker dies waits until this is noticed, each time.
    """
    waits = "SELECT max((started_at - created_at) / (restarts + 1)) FROM jobs"
    with library.store.read() as connection:
        return float(connection.exec_driver_sql(waits).scalar() or 0.0)


def section(done: Counter[str], account: Account, states: Counter[str], quiet: float, longest: float, seed: int) -> str:
    rows = [
        ["workers killed", done["worker"]],
        ["servers killed", done["server"]],
        ["stops of PostgreSQL", done["stop"]],
        ["acknowledged uploads", len(account.acknowledged) + sum(account.known.values())],
        ["their jobs, succeeded", states["succeeded"]],
        ["their jobs, failed or lost", sum(states.values()) - states["succeeded"]],
        ["answers 503 with Retry-After", account.answers["503 with Retry-After"]],
        ["requests without an answer", account.answers["no answer"]],
        ["longest wait for an attempt at a job, s", f"{longest:.0f}"],
        ["from the end of the disturbances to the last job's end, s", f"{quiet:.0f}"],
        ["faults", len(account.faults)],
    ]
    return f"""\
## A cluster

Two servers, three workers and PostgreSQL on one machine. `python -m benchmarks.cluster.chaos --seed {seed}` kills
servers and workers at random (SIGKILL), and stops and starts PostgreSQL, while {CLIENTS} clients upload meshes and
follow their jobs at the other server. A fault is an acknowledged upload without its shape, a mesh with two shapes, a
job that failed, was lost, still waits or waited longer than the bound, or an unexpected status. The job of a dead
worker runs again after at most {BOUND:.0f} s, the bound.

{table(["", ""], rows)}
"""


if __name__ == "__main__":
    main()
