"""Uploads to a disk that fills: what was acknowledged is there, and what ends, ends."""

from __future__ import annotations

import random
import sqlite3
import threading
import time
from collections import Counter
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import httpx

from benchmarks.common import table
from benchmarks.service.reliability_kills import Report, progress
from tests.support.disk import small_disk
from tests.support.server import Server
from unbend.mesh.shapes import torus
from unbend.mesh.write import write_mesh

DISK_MB: Final = 160
SETTINGS: Final = {"max_upload_mb": 16, "reserve_mb": 24, "max_queued": 200}
SMALL: Final = 6
LARGE: Final = 3
LARGE_BYTES: Final = 8 * 2**20
RING: Final = write_mesh(torus(columns=10, rows=6).vertices, torus(columns=10, rows=6).faces, "off")
REMOVED: Final = 0.5
"""Shapes of a large uploader that it removes when the disk is full."""


@dataclass
class Uploader:
    """Sends files, remembers what was acknowledged, and removes some of it when the disk is full."""

    number: int
    extra: int
    seed: int
    jobs: list[str] = field(default_factory=list)
    answers: Counter = field(default_factory=Counter)
    removed: set[str] = field(default_factory=set)

    def run(self, url: str, end: float) -> None:
        chance = random.Random(1000 * self.seed + self.number)  # noqa: S311
        sent = 0
        with httpx.Client(base_url=url, timeout=90.0) as http:
            while time.monotonic() < end:
                sent += 1
                data = (
                    RING + b"# %d %d " % (self.number, sent) + chance.randbytes(8).hex().encode() * self.extra + b"\n"
                )
                form = {"files": {"file": ("m.off", data)}, "data": {"parameters": '{"samples": 40}'}}
                response = http.post("/v1/shapes", **form)
                code = response.json().get("code", "") if response.status_code >= 400 else ""
                self.answers[f"{response.status_code} {code}".strip()] += 1
                if response.status_code == 202:
                    self.jobs.append(response.json()["id"])
                elif self.extra and chance.random() < REMOVED:
                    self._remove(http, chance)
                else:
                    time.sleep(0.05)

    def _remove(self, http: httpx.Client, chance: random.Random) -> None:
        for job_id in chance.sample(self.jobs, min(3, len(self.jobs))):
            shape_id = http.get(f"/v1/jobs/{job_id}").json().get("shape_id")
            if shape_id and shape_id not in self.removed and http.delete(f"/v1/shapes/{shape_id}").status_code == 204:
                self.removed.add(shape_id)
                self.answers["removed"] += 1


def fill_disk(seconds: float, seed: int) -> Report:
    """Have small and large uploaders fill a small disk for so long; report what was lost or left."""
    uploaders = [Uploader(number, 0, seed) for number in range(SMALL)]
    uploaders += [Uploader(SMALL + number, LARGE_BYTES // 16, seed) for number in range(LARGE)]
    with TemporaryDirectory() as folder, small_disk(Path(folder), DISK_MB), Server(Path(folder), **SETTINGS) as server:
        end = time.monotonic() + seconds
        threads = [threading.Thread(target=uploader.run, args=(server.url, end)) for uploader in uploaders]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        progress("disk: all have stopped sending")
        lost, stuck, ended = _look(server, uploaders)
        server.process.terminate()
        begun = time.monotonic()
        server.process.wait(60)
        took = time.monotonic() - begun
        with closing(sqlite3.connect(server.library)) as connection:
            sound = connection.execute("PRAGMA integrity_check").fetchone()[0]
    answers = sum((uploader.answers for uploader in uploaders), Counter())
    faults = [f"{lost} acknowledged uploads lost"] * bool(lost) + [f"{stuck} jobs stuck"] * bool(stuck)
    faults += [f"integrity check: {sound}"] * (sound != "ok")
    faults += [f"{count} answers {name}" for name, count in answers.items() if name.startswith("500")]
    rows = [
        ["uploads acknowledged", sum(len(uploader.jobs) for uploader in uploaders)],
        *[[f"answers: {name}", count] for name, count in sorted(answers.items()) if not name.startswith("202")],
        *[[f"jobs that ended: {state}", count] for state, count in sorted(ended.items())],
        ["acknowledged uploads lost", lost],
        ["jobs that did not end", stuck],
        ["integrity check", sound],
        ["seconds until the server ended", f"{took:.1f}"],
    ]
    text = (
        f"For {seconds:g} s (seed {seed}) {SMALL} clients uploaded small meshes, and {LARGE} clients meshes of "
        f"{LARGE_BYTES // 2**20} MB, to a server whose library is on a disk of {DISK_MB} MB. When the disk was full, "
        "the clients with large meshes removed some of their shapes.\n\n" + table(["", ""], rows)
    )
    return Report(text, faults)


def _look(server: Server, uploaders: list[Uploader]) -> tuple[int, int, Counter]:
    """Count acknowledged jobs that are not there, or whose shape is not; those that do not end; and how others did."""
    lost = stuck = 0
    ended: Counter = Counter()
    with server.http() as http:
        for uploader in uploaders:
            for job_id in uploader.jobs:
                _make_room(http, uploaders)
                response = http.get(f"/v1/jobs/{job_id}", params={"wait": 60})
                if response.status_code != 200:
                    lost += 1
                    continue
                job = response.json()
                ended[job["state"]] += 1
                stuck += job["state"] in {"queued", "running"}
                if job["state"] == "succeeded" and job["shape_id"] not in uploader.removed:
                    lost += http.get(f"/v1/shapes/{job['shape_id']}").status_code != 200
    return lost, stuck, ended


def _make_room(http: httpx.Client, uploaders: list[Uploader]) -> None:
    """Remove shapes, those of large uploaders first, until jobs go on: those that wait have no room for results."""
    if http.get("/v1/readyz").status_code == 200:
        return
    for uploader in reversed(uploaders):
        for number, job_id in enumerate(uploader.jobs):
            if number % 20 == 19 and http.get("/v1/readyz").status_code == 200:
                return
            shape_id = http.get(f"/v1/jobs/{job_id}").json().get("shape_id")
            if shape_id and shape_id not in uploader.removed:
                uploader.removed.add(shape_id)
                http.delete(f"/v1/shapes/{shape_id}")
