"""Throughput of the service, compared with plain processes and a bare endpoint, and its latency while it computes.

    python -m benchmarks.service.throughput [MESHES]

Two processes without a service, and the service with two workers over HTTP, compute MESHES files of SHREC'11 (240 by
default) in turns. Then clients read stored records from an idle server, from a server whose workers all compute, and
from a bare FastAPI endpoint that returns a record from memory. Writes the section "service" of docs/reliability.md.
"""

from __future__ import annotations

import json
import multiprocessing
import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Self

import numpy as np

from benchmarks.common import DATA, ROOT, table, write_section
from benchmarks.service.http import Connection, multipart
from tests.support.server import ENDLESS, Server, endless_mesh, small_mesh, stored
from unbend.jobs.limits import limit_process
from unbend.jobs.worker import warm_up
from unbend.mesh.read import read_mesh
from unbend.signature.pipeline import compute_signature

WORKERS = 2
UPLOADERS = 8
TURNS = 3
READS = 500
READ_TURNS = 12
READERS = 4


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 240
    files = sorted((DATA / "shrec11_simplified").glob("*.obj"))[:count]
    with TemporaryDirectory(prefix="unbend-service-") as folder:
        rates = throughput(files, Path(folder))
        reads, share = reading(Path(folder) / "reads")
    write_section(ROOT / "docs" / "reliability.md", "service", text(files, rates, reads, share))


def throughput(files: Sequence[Path], folder: Path) -> dict[str, list[float]]:
    """Return the meshes per second without and with the service, for each turn."""
    rates: dict[str, list[float]] = {"bare": [], "service": []}
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(WORKERS, context, limit_process, (None,)) as bare:
        list(bare.map(warmed, range(4 * WORKERS)))
        for turn in range(TURNS):
            rates["bare"].append(rate_of(files, lambda: list(bare.map(signature_of, files))))
            with Server(folder / f"turn-{turn}", workers=WORKERS) as server:
                upload_all(server, files[:WORKERS], {"samples": 20})
                rates["service"].append(rate_of(files, lambda to=server: upload_all(to, files)))
    return rates


def rate_of(files: Sequence[Path], compute: Any) -> float:
    start = time.perf_counter()
    compute()
    return len(files) / (time.perf_counter() - start)


def warmed(_turn: int) -> None:
    warm_up()


def signature_of(path: Path) -> float:
    return compute_signature(read_mesh(path), threads=1).stress


def upload_all(server: Server, files: Sequence[Path], parameters: dict[str, Any] | None = None) -> None:
    """Upload every file over several connections, and wait until each has a signature."""
    left = iter(files)
    lock = threading.Lock()

    def one_after_the_other(_number: int) -> None:
        with Connection(server.url) as http:
            while True:
                with lock:
                    path = next(left, None)
                if path is None:
                    return
                fields = {"parameters": json.dumps(parameters or {})}
                status, answer = http.send("POST", "/v1/shapes", *multipart(path.name, path.read_bytes(), fields))
                job = json.loads(answer)
                while status == 202 and job["state"] in {"queued", "running"}:
                    job = json.loads(http.send("GET", f"/v1/jobs/{job['id']}?wait=30")[1])
                assert job["state"] == "succeeded", job

    with ThreadPoolExecutor(UPLOADERS) as pool:
        list(pool.map(one_after_the_other, range(UPLOADERS)))


def reading(folder: Path) -> tuple[dict[str, Readings], float]:
    """Return readings of a bare endpoint, an idle server and a computing server, and the rate of idle over bare."""
    with Server(folder, workers=WORKERS) as server, server.http() as http:
        record = stored(http, small_mesh(1))
        path = f"/v1/shapes/{record['id']}"
        with bare_endpoint(record) as bare:
            turns = [(Readings.of(bare, "/"), Readings.of(server.url, path)) for _ in range(READ_TURNS)]
        found = dict(zip(("bare", "idle"), map(Readings.together, zip(*turns, strict=True)), strict=True))
        share = float(np.median([idle.rate / bare.rate for bare, idle in turns]))
        jobs = [post_endless(server, samples) for samples in range(ENDLESS["samples"], ENDLESS["samples"] + WORKERS)]
        while any(http.get(job).json()["stage"] != "geodesics" for job in jobs):
            time.sleep(0.1)
        found["computing"] = Readings.together([Readings.of(server.url, path) for _ in range(READ_TURNS)])
        for job in jobs:
            http.delete(job)
    return found, share


def post_endless(server: Server, samples: int) -> str:
    with Connection(server.url) as http:
        body = multipart("endless.ply", endless_mesh(), {"parameters": json.dumps({"samples": samples})})
        return f"/v1/jobs/{json.loads(http.send('POST', '/v1/shapes', *body)[1])['id']}"


class Readings:
    """The seconds of many reads on one connection, and the reads per second on several connections."""

    def __init__(self, seconds: np.ndarray, rate: float) -> None:
        self.seconds, self.rate = seconds, rate

    @classmethod
    def of(cls, url: str, path: str) -> Self:
        with Connection(url) as http:
            list(timed(http, path, READS // 10))
            seconds = np.array(list(timed(http, path, READS)))
        start = time.perf_counter()
        with ThreadPoolExecutor(READERS) as pool:
            list(pool.map(lambda _: read_many(url, path, READS // READERS), range(READERS)))
        return cls(seconds, READS / (time.perf_counter() - start))

    @classmethod
    def together(cls, turns: Sequence[Self]) -> Self:
        return cls(np.concatenate([each.seconds for each in turns]), float(np.median([each.rate for each in turns])))

    def row(self) -> list[str]:
        median, late = np.quantile(self.seconds, [0.5, 0.99]) * 1e3
        return [f"{self.rate:.0f}", f"{median:.2f}", f"{late:.2f}"]


def timed(http: Connection, path: str, count: int) -> Iterator[float]:
    for _ in range(count):
        start = time.perf_counter()
        status, _ = http.send("GET", path)
        assert status == 200
        yield time.perf_counter() - start


def read_many(url: str, path: str, count: int) -> None:
    with Connection(url) as http:
        list(timed(http, path, count))


@contextmanager
def bare_endpoint(record: dict[str, Any]) -> Iterator[str]:
    """Serve `record` from memory with FastAPI and uvicorn, and yield the address."""
    command = [sys.executable, "-m", "benchmarks.service.bare", json.dumps(record)]
    with subprocess.Popen(command, cwd=ROOT, stderr=subprocess.PIPE, text=True) as process:
        try:
            lines = iter(process.stderr.readline, "") if process.stderr else iter(())
            yield next(
                found.group(1) for line in lines if (found := re.search(r"running on (http://[\d.]+:\d+)", line))
            )
        finally:
            process.terminate()


def text(files: Sequence[Path], rates: dict[str, list[float]], reads: dict[str, Readings], share: float) -> str:
    parts = [ours / bare for ours, bare in zip(rates["service"], rates["bare"], strict=True)]
    turns = [
        [turn + 1, f"{bare:.1f}", f"{ours:.1f}", f"{part:.0%}"]
        for turn, (bare, ours, part) in enumerate(zip(rates["bare"], rates["service"], parts, strict=True))
    ]
    names = {"bare": "a bare FastAPI endpoint, from memory", "idle": "idle", "computing": "both workers computing"}
    p99 = {name: np.quantile(found.seconds, 0.99) for name, found in reads.items()}
    return f"""{len(files)} meshes of 252 vertices, default parameters, {WORKERS} processes. Over HTTP, {UPLOADERS} clients on the same machine upload each mesh and wait for it.

{table(["turn", "without a service, meshes/s", "over HTTP, meshes/s", "share"], turns)}

`GET /v1/shapes/{{id}}`: the rate on {READERS} connections, and the times on one connection; {READ_TURNS} turns of {READS} reads, alternating between the bare and the idle server.

{table(["server", "reads/s", "median, ms", "p99, ms"], [[names[name], *found.row()] for name, found in reads.items()])}

The idle rate is {share:.2f} of the bare endpoint's (median of the turns). The p99 while computing is {p99["computing"] / p99["idle"]:.1f} times the idle server's."""  # noqa: E501


if __name__ == "__main__":
    main()
