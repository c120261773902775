"""Sends damaged mesh files to a running service, which must answer each and stay healthy.

    python -m benchmarks.service.fuzz [COUNT] [--seed SEED] [--print]
    python -m benchmarks.service.fuzz --show FORMAT NUMBER > mesh

tests/support/fuzzing.py makes COUNT files (100,000 by default) from small valid ones, as many of each format. Every
tenth file is uploaded as a shape, the others as queries. The second form writes one of the files to standard output.
Writes the section "fuzz" of docs/reliability.md. Exits with status 1 if there was a fault.
"""

from __future__ import annotations

import argparse
import contextlib
import sqlite3
import sys
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import httpx

from benchmarks.common import ROOT, table, write_section
from tests.support.fuzzing import FORMATS, file_name, mutant
from tests.support.server import Server, small_mesh, stored

PAGE = ROOT / "docs" / "reliability.md"
HEADING = "# Reliability\n"
CONNECTIONS = 4
BATCH = 250
WAITING = 200
"""The next batch is sent when at most this many jobs are unfinished, so that they and a batch fit in one list."""
LISTED = 500
LOOK_SECONDS = 0.2
ENDED = ("succeeded", "failed", "cancelled")
SECONDS, MEMORY_MB, WORKERS = 20, 3072, 2
PARAMETERS = '{"samples": 8}'
SHAPE_EVERY = 10
SEED = 1

REFUSALS = {"mesh_format"}
FAILURES = {"mesh_format", "mesh_read", "mesh_geometry", "mesh_too_large"}
"""Allowed error codes of jobs. Codes of time and memory limits are not allowed, because all files are small."""


@dataclass
class Tally:
    """The outcomes of the files of one format."""

    files: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    ended: Counter[str] = field(default_factory=Counter)
    slowest: float = 0.0
    slowest_number: int = 0


@dataclass
class Peak:
    """The peak memory of the processes, in bytes, and the ids of all workers seen."""

    server: int = 0
    worker: int = 0
    workers: set[int] = field(default_factory=set)

    def look(self, server: Server) -> None:
        self.server = max(self.server, peak_bytes(server.process.pid))
        for pid in server.workers():
            self.workers.add(pid)
            self.worker = max(self.worker, peak_bytes(pid))


class Run:
    """One run: sends files, and records outcomes and faults."""

    def __init__(self, server: Server, http: httpx.Client, seed: int) -> None:
        self.tallies = {kind: Tally() for kind in FORMATS}
        self.faults: list[str] = []
        self.peak = Peak()
        self._server, self._http, self._seed = server, http, seed
        self._waiting: dict[str, tuple[str, int]] = {}

    def send(self, files: list[tuple[str, int]]) -> None:
        with ThreadPoolExecutor(CONNECTIONS) as pool:
            for (kind, number), response in zip(files, pool.map(self._post, files), strict=True):
                self._note_answer(kind, number, response)

    def settle(self, most: int) -> None:
        """Wait until at most `most` jobs are unfinished, and note the jobs that have ended."""
        while True:
            load = self._http.get("/v1/capacity").json()
            if load["running"] + load["queued"] <= most:
                break
            time.sleep(LOOK_SECONDS)
        for state in ENDED:
            for job in self._http.get("/v1/jobs", params={"state": state, "limit": LISTED}).json()["items"]:
                if job["id"] in self._waiting:
                    self._note_job(*self._waiting.pop(job["id"]), job)
        self.peak.look(self._server)

    @property
    def unanswered(self) -> int:
        return len(self._waiting)

    def _post(self, file: tuple[str, int]) -> httpx.Response:
        kind, number = file
        path = "/v1/shapes" if number % SHAPE_EVERY == 0 else "/v1/queries"
        upload = {"file": (file_name(kind, number), mutant(kind, number, self._seed))}
        return self._http.post(path, files=upload, data={"parameters": PARAMETERS})

    def _note_answer(self, kind: str, number: int, response: httpx.Response) -> None:
        tally, answer = self.tallies[kind], response.json()
        tally.files += 1
        if response.status_code == httpx.codes.ACCEPTED:
            self._waiting[answer["id"]] = kind, number
        elif response.status_code == httpx.codes.OK:
            tally.ended["succeeded"] += 1  # the same bytes were sent before
        else:
            tally.refused[answer["code"]] += 1
            if answer["code"] not in REFUSALS:
                self.faults.append(f"{kind} {number}: {response.status_code} {answer['code']}: {answer['detail']}")

    def _note_job(self, kind: str, number: int, job: dict[str, Any]) -> None:
        tally, code = self.tallies[kind], job["error"]["code"] if job["error"] else job["state"]
        tally.ended[code] += 1
        seconds = (
            datetime.fromisoformat(job["finished_at"]) - datetime.fromisoformat(job["started_at"])
        ).total_seconds()
        if seconds > tally.slowest:
            tally.slowest, tally.slowest_number = seconds, number
        if (
            code not in FAILURES | {"succeeded"}
            or job["attempts"] != 1
            or (job["error"] and not job["error"]["message"])
        ):
            self.faults.append(f"{kind} {number}: job {code}, {job['attempts']} attempts: {job['error']}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("count", nargs="?", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--show", nargs=2, metavar=("FORMAT", "NUMBER"))
    parser.add_argument("--print", action="store_true", dest="only_print", help="leave docs/reliability.md alone")
    options = parser.parse_args()
    if options.show:
        sys.stdout.buffer.write(mutant(options.show[0], int(options.show[1]), options.seed))
        return
    with TemporaryDirectory(prefix="unbend-fuzz-") as folder:
        text, faults = fuzz(Path(folder), options.count, options.seed)
    print("\n".join(faults))
    if options.only_print:
        print(text)
    else:
        if not PAGE.exists():
            PAGE.write_text(HEADING)
        write_section(PAGE, "fuzz", text)
    sys.exit(bool(faults))


def fuzz(folder: Path, count: int, seed: int) -> tuple[str, list[str]]:
    """Send `count` files; return the text of the page and one line for each fault."""
    limits = {"job_seconds": SECONDS, "job_memory_mb": MEMORY_MB}
    with Server(folder, workers=WORKERS, **limits) as server, httpx.Client(base_url=server.url, timeout=60) as http:
        stored(http, small_mesh(0), label="torus", parameters=PARAMETERS)  # so that queries have a result
        run, begun = Run(server, http, seed), time.perf_counter()
        run.peak.look(server)
        first = set(run.peak.workers)
        for batch in batches(count):
            run.send(batch)
            run.settle(WAITING)
            show_progress(sum(tally.files for tally in run.tallies.values()), count)
        run.settle(0)
        seconds = time.perf_counter() - begun
        faults = run.faults + list(_after(server, http, run, first))
    with contextlib.closing(sqlite3.connect(server.library)) as connection:
        integrity = connection.execute("PRAGMA integrity_check").fetchone()[0]
    if integrity != "ok":
        faults.append(f"the library's integrity: {integrity}")
    return report(run, seconds, seed, faults), faults


def batches(count: int) -> Iterator[list[tuple[str, int]]]:
    files = [(kind, number) for number in range(-(-count // len(FORMATS))) for kind in FORMATS][:count]
    for start in range(0, count, BATCH):
        yield files[start : start + BATCH]


def _after(server: Server, http: httpx.Client, run: Run, first: set[int]) -> Iterator[str]:
    """Yield the faults of the server at the end."""
    if server.process.poll() is not None:
        yield "the server has ended"
        return
    if http.get("/v1/livez").status_code != httpx.codes.OK:
        yield "the server is not alive"
    if run.unanswered:
        yield f"{run.unanswered} jobs have no end"
    if run.peak.workers != first:
        yield f"{len(run.peak.workers - first)} workers were replaced"
    if run.peak.worker > MEMORY_MB * 2**20:
        yield "a worker had more memory than allowed"
    if max(tally.slowest for tally in run.tallies.values()) > SECONDS:
        yield "a job ran longer than allowed"
    log = server.log.read_text(errors="replace")
    for word in ("Traceback", " ERROR ", " CRITICAL "):
        if word in log:
            yield f"{log.count(word)} times {word.strip()} in the log"


def report(run: Run, seconds: float, seed: int, faults: list[str]) -> str:
    codes = sorted(FAILURES | {code for tally in run.tallies.values() for code in tally.ended} - {"succeeded"})
    header = ["format", "files", "refused at once", "succeeded", *(f"`{code}`" for code in codes), "slowest job, s"]
    rows = [
        [kind, f"{tally.files:,}", f"{tally.refused.total():,}", f"{tally.ended['succeeded']:,}",
         *(f"{tally.ended[code]:,}" for code in codes), f"{tally.slowest:.2f}"]
        for kind, tally in run.tallies.items()
    ]  # fmt: skip
    total = sum(tally.files for tally in run.tallies.values())
    peak = run.peak
    summary = (
        f"{total:,} damaged files (seed {seed}) in {seconds:,.0f} s, {total / seconds:.0f} a second, sent to a server "
        f"with {WORKERS} workers and limits of {SECONDS} s and {MEMORY_MB:,} MB a job. Peak memory: the server "
        f"{peak.server / 2**20:.0f} MB, a worker {peak.worker / 2**20:.0f} MB."
    )
    verdict = "\n".join(f"- {fault}" for fault in faults[:20]) or (
        "Every file got a response, and each refusal and failure one of the codes below and a message. No worker died "
        "or was stopped, the log has no error, and the library's integrity check says ok."
    )
    return f"{summary}\n\n{verdict}\n\n{table(header, rows)}"


def peak_bytes(pid: int) -> int:
    """Return the peak resident memory of a process, or 0 if the process has ended."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        return 0
    return next((int(line.split()[1]) * 1024 for line in lines if line.startswith("VmHWM")), 0)


def show_progress(done: int, count: int) -> None:
    if sys.stderr.isatty():
        print(f"\r{done:,} of {count:,}", end="", file=sys.stderr)


if __name__ == "__main__":
    main()
