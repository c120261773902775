"""A library that cannot grow while clients write to it: a limit on file sizes, which needs no root rights, stops it."""

from __future__ import annotations

import json
import random
import resource
import sqlite3
import threading
import time
from collections import Counter
from contextlib import closing
from dataclasses import dataclass, field

import httpx

from tests.support.server import SAMPLES, Server, ended, post_mesh, small_mesh
from unbend.mesh.shapes import torus
from unbend.mesh.write import write_mesh

FEW = json.dumps(SAMPLES)
SECONDS = 8.0
ROOM = 6 * 2**20
LARGE = 2**20
RING = write_mesh(torus(columns=10, rows=6).vertices, torus(columns=10, rows=6).faces, "off")


@dataclass
class Uploader:
    """Uploads files and remembers acknowledged jobs; an uploader of large files also removes shapes at random."""

    number: int
    extra: int
    jobs: list[str] = field(default_factory=list)
    removed: set[str] = field(default_factory=set)
    answers: Counter[int] = field(default_factory=Counter)

    def run(self, url: str) -> None:
        chance = random.Random(self.number)  # noqa: S311
        end = time.monotonic() + SECONDS
        with httpx.Client(base_url=url, timeout=90.0) as http:
            while time.monotonic() < end:
                data = RING + b"# " + chance.randbytes(8).hex().encode() * (1 + self.extra // 16) + b"\n"
                response = post_mesh(http, data, file_name="m.off", parameters=FEW)
                self.answers[response.status_code] += 1
                if response.status_code == 202:
                    self.jobs.append(response.json()["id"])
                if self.extra and self.jobs and chance.random() < 0.3:
                    self.remove(http, chance.choice(self.jobs))

    def remove(self, http: httpx.Client, job_id: str) -> None:
        found = http.get(f"/v1/jobs/{job_id}")
        shape_id = found.json().get("shape_id") if found.status_code == 200 else None
        if shape_id and http.delete(f"/v1/shapes/{shape_id}").status_code == 204:
            self.removed.add(shape_id)


def limit_files(server: Server, size: int) -> None:
    _, most = resource.prlimit(server.process.pid, resource.RLIMIT_FSIZE)
    resource.prlimit(server.process.pid, resource.RLIMIT_FSIZE, (size, most))


def test_no_acknowledged_job_is_lost_or_stuck_when_the_library_cannot_grow(tmp_path):
    uploaders = [Uploader(number, 0) for number in range(6)] + [Uploader(number, LARGE) for number in range(6, 9)]
    with Server(tmp_path, workers=1) as server, server.http() as http:
        ended(http, post_mesh(http, small_mesh(0), parameters=FEW))
        limit_files(server, server.library.stat().st_size + ROOM)
        threads = [threading.Thread(target=uploader.run, args=(server.url,)) for uploader in uploaders]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        limit_files(server, resource.RLIM_INFINITY)
        for uploader in uploaders:
            for job_id in uploader.jobs:
                job = http.get(f"/v1/jobs/{job_id}", params={"wait": 60}).raise_for_status().json()
                assert job["state"] == "succeeded", job
                status = http.get(f"/v1/shapes/{job['shape_id']}").status_code
                assert status == (404 if job["shape_id"] in uploader.removed else 200)
        assert http.get("/v1/capacity").json()["running"] == 0
    answers = sum((uploader.answers for uploader in uploaders), Counter())
    assert answers[202] > 0
    assert answers[503] + answers[507] > 0  # otherwise the limit was never reached
    assert set(answers) <= {202, 429, 503, 507}
    with closing(sqlite3.connect(server.library)) as connection:
        assert connection.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
