"""Kills workers of a real server at chosen and random moments, and checks the effect on jobs."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import httpx
import numpy as np

from tests.support.footprint import is_asleep, writes_to_a_pipe
from tests.support.server import SAMPLES, Server, is_running, ply
from unbend.mesh.shapes import torus
from unbend.progress import STAGES

MOMENTS: Final = ("computing", "sending", "taking", "idle")
"""The moments of a kill: during computation, while sending a result, while receiving a job, and while idle."""

PATIENCE: Final = 60.0
LARGE: Final = {"samples": 1000}
"""Parameters whose result does not fit into a pipe."""

_WORKERS_PATIENCE: Final = 60.0


@dataclass(frozen=True)
class Sent:
    """An acknowledged upload or query."""

    kind: str
    job: str
    data: bytes


@dataclass(frozen=True)
class Kill:
    """The kill of a worker, and its effects."""

    moment: str
    jobs: int
    hit: int
    """Number of jobs that were started twice."""
    stage: str | None
    """The stage that the repeated job had reported last; None without such a job or report."""
    in_a_pipe: bool
    """Whether the worker was waiting to write to a full pipe."""
    seconds: float
    """Time from the kill to the end of all jobs."""
    faults: tuple[str, ...]


class WorkerKiller:
    """Sends jobs to a server, and kills its workers."""

    def __init__(self, server: Server, http: httpx.Client, random: np.random.Generator) -> None:
        self._server = server
        self._http = http
        self._random = random
        self._number = 0

    def kill(self, moment: str) -> Kill:
        """Kill one worker at this kind of moment, while other jobs run, and wait until all jobs have ended."""
        return getattr(self, f"_{moment}")()

    def _computing(self) -> Kill:
        self._idle_workers()
        jobs = [self._send(*self._random.integers(8, 40, 2), SAMPLES | {"samples": 200}) for _ in range(6)]
        stage = self._random.choice(["", *STAGES[1:]])
        end = time.monotonic() + self._random.uniform(0.2, 1.0)
        while time.monotonic() < end and stage and stage not in self._reported().values():
            time.sleep(0.0005)
        time.sleep(self._random.uniform(0.0, 0.02 if stage else 0.5))
        return self._after("computing", jobs, self._any_worker())

    def _sending(self) -> Kill:
        workers = self._idle_workers()
        jobs = [self._send(40, 30, LARGE) for _ in range(2)] + [self._send(10, 6, SAMPLES) for _ in range(2)]
        self._until(lambda: "embedding" in self._reported().values())
        reported = self._reported()
        with self._stopped([self._server.process.pid]):  # the server does not read, so a result fills the pipe
            self._until(lambda: self._stay_asleep(workers))
            sending = [pid for pid in workers if writes_to_a_pipe(pid)]
            return self._after(
                "sending", jobs, self._random.choice(sending or workers), reported, in_a_pipe=bool(sending)
            )

    def _taking(self) -> Kill:
        workers = self._idle_workers()
        victim = self._random.choice(workers)
        with self._stopped(workers):
            jobs = [self._send(10, 6, SAMPLES) for _ in range(4)]
            time.sleep(0.1)  # so that the jobs are in the pipe
            os.kill(victim, signal.SIGCONT)
            time.sleep(self._random.uniform(0.0, 0.004))
            os.kill(victim, signal.SIGKILL)
        return self._after("taking", jobs, None)

    def _idle(self) -> Kill:
        os.kill(self._random.choice(self._idle_workers()), signal.SIGKILL)
        time.sleep(0.5)
        return self._after("idle", [self._send(10, 6, SAMPLES) for _ in range(3)], None, most=0)

    def _send(self, columns: int, rows: int, parameters: dict[str, int]) -> Sent:
        """Send a new torus as an upload or a query."""
        self._number += 1
        data = ply(torus(minor=0.2 + 1e-4 * self._number, columns=int(columns), rows=int(rows)))
        kind = "queries" if self._number % 3 == 0 else "shapes"
        response = self._http.post(
            f"/v1/{kind}", files={"file": ("mesh.ply", data)}, data={"parameters": json.dumps(parameters)}
        )
        assert response.status_code == httpx.codes.ACCEPTED, response.text
        return Sent(kind, response.json()["id"], data)

    def _after(
        self, moment: str, jobs: list[Sent], victim: int | None, reported: dict[str, str] | None = None,
        *, most: int = 1, in_a_pipe: bool = False,
    ) -> Kill:  # fmt: skip
        """Kill the worker, resume a stopped server, wait for the jobs, and check them."""
        stages = self._reported() if reported is None else reported
        if victim is not None:
            os.kill(victim, signal.SIGKILL)
        os.kill(self._server.process.pid, signal.SIGCONT)
        start = time.monotonic()
        ended = [self._ended(sent, start + PATIENCE) for sent in jobs]
        seconds = time.monotonic() - start
        hit = [job["id"] for job in ended if job["attempts"] > 1]
        faults = [fault for sent, job in zip(jobs, ended, strict=True) for fault in self._faults(sent, job)]
        if len(hit) > most:
            faults.append(f"{moment}: {len(hit)} jobs were started twice after one process was killed")
        stage = stages.get(hit[0]) if hit else None
        return Kill(moment, len(jobs), len(hit), stage, in_a_pipe, seconds, tuple(faults))

    def _ended(self, sent: Sent, end: float) -> dict:
        while True:
            job = self._http.get(f"/v1/jobs/{sent.job}", params={"wait": 5}).raise_for_status().json()
            if job["state"] not in {"queued", "running"} or time.monotonic() > end:
                return job

    def _faults(self, sent: Sent, job: dict) -> Iterator[str]:
        if job["state"] != "succeeded" or job["attempts"] > 2:
            yield f"{sent.kind} job: {job['state']} after {job['attempts']} attempts: {job['error']}"
        elif sent.kind == "shapes" and self._http.get(f"/v1/shapes/{job['shape_id']}/mesh").content != sent.data:
            yield f"the file of shape {job['shape_id']} differs from the upload"

    def _reported(self) -> dict[str, str]:
        """Return the stage that each running job has reported last."""
        running = self._http.get("/v1/jobs", params={"state": "running"}).raise_for_status().json()["items"]
        return {job["id"]: job["stage"] for job in running}

    def _any_worker(self) -> int | None:
        workers = self._server.workers()
        return int(self._random.choice(workers)) if workers else None

    def _idle_workers(self) -> list[int]:
        """Wait until all workers have loaded their kernels and are idle; return them."""
        self._until(lambda: len(self._server.workers()) == 2 and self._stay_asleep(self._server.workers()))
        return self._server.workers()

    def _stay_asleep(self, pids: list[int]) -> bool:
        for _ in range(4):
            if not all(map(is_asleep, filter(is_running, pids))):
                return False
            time.sleep(0.02)
        return True

    def _until(self, reached) -> None:
        end = time.monotonic() + _WORKERS_PATIENCE
        while not reached() and time.monotonic() < end:
            time.sleep(0.002)

    @contextlib.contextmanager
    def _stopped(self, pids: list[int]) -> Iterator[None]:
        """Stop processes (SIGSTOP) within this context."""
        for pid in pids:
            os.kill(pid, signal.SIGSTOP)
        try:
            yield
        finally:
            for pid in pids:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGCONT)
