"""A real server in its own process, and small meshes to send to it."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import mkdtemp
from typing import TypeVar

import httpx
import numpy as np

from unbend import Surface
from unbend.mesh.shapes import torus
from unbend.mesh.write import write_mesh

T = TypeVar("T")

IDLE_SECONDS = 60.0
"""Time without CPU use after which a starting server counts as hanging."""
LONGEST_SECONDS = 900.0
"""Longest start, on a machine that other work keeps busy."""
SAMPLES = {"samples": 40}
"""Parameters for tests that need any signature."""

DAMAGED = b"OFF\n4 4 0\n0 0 0\n1 0 0\n"
"""An off file that ends early."""


def ply(surface: Surface) -> bytes:
    return write_mesh(surface.vertices, surface.faces, "ply")


def small_mesh(number: int) -> bytes:
    """Return a torus of 60 vertices, different for each number."""
    wider, thicker = divmod(number, 700)
    return ply(torus(major=1.0 + 0.001 * wider, minor=0.2 + 0.001 * thicker, columns=10, rows=6))


def two_rings(number: int, **grid: int) -> Surface:
    """Return two separate tori, the smaller of 18 vertices; different for each number."""
    large = torus(minor=0.2 + 0.001 * number, **({"columns": 10, "rows": 6} | grid))
    small = torus(major=0.5, minor=0.1, columns=6, rows=3)
    faces = np.concatenate([large.faces, small.faces + len(large.vertices)])
    return Surface(np.concatenate([large.vertices, small.vertices + np.array([3.0, 0.0, 0.0])]), faces)


def medium_mesh() -> bytes:
    """Return a mesh whose signature takes about a second."""
    return ply(torus(columns=80, rows=60))


def slow_mesh() -> bytes:
    """Return a mesh of less than a megabyte whose signature takes minutes with 3000 samples or more."""
    return ply(torus(columns=180, rows=120))


def endless_mesh() -> bytes:
    """Return a mesh whose signature takes minutes with 2000 samples."""
    return ply(torus(columns=400, rows=250))


ENDLESS = {"samples": 2000}


def workers_of(pid: int) -> list[int]:
    """Return the worker processes of `pid`: children of its fork server."""
    return [worker for fork_server in children(pid, "forkserver") for worker in children(fork_server, "forkserver")]


def children(pid: int, containing: str) -> list[int]:
    """Return the child processes of `pid` whose command line contains a word."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
            command = (folder / "cmdline").read_bytes().decode()
        except (OSError, ValueError):
            continue
        if parent == pid and containing in command:
            found.append(int(folder.name))
    return sorted(found)


def cpu_seconds(pid: int) -> float:
    """Return the CPU time of a process, or 0 if the process has ended."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def is_running(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


def without_settings(**settings: str) -> dict[str, str]:
    """Return the environment of this process, with only the given UNBEND_ settings."""
    return {name: value for name, value in os.environ.items() if not name.startswith("UNBEND_")} | settings


class Server:
    """`unbend serve` on this machine, by default on a free port and ready after its construction.

    Without the URL of a `library`, it has its own in `folder`.
    """

    command = "serve"
    prefix = "/v1"
    """The path of the probes."""

    def __init__(
        self,
        folder: Path,
        *,
        library: str | None = None,
        workers: int = 2,
        ready: bool = True,
        host: str = "127.0.0.1",
        port: int = 0,
        within: Sequence[str] = (),
        temporary: Path | None = None,
        parts: bool = False,
        **settings: object,
    ) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.library = folder / "library.db"
        self.log = folder / "server.log"
        # Not within `folder`: the path of a socket, which workers need, must be short.
        self._own_temporary = temporary is None
        self.temporary = temporary or Path(mkdtemp(prefix="unbend-"))
        environment = without_settings(
            TMPDIR=str(self.temporary),
            UNBEND_LOCAL_SIGNATURES=str(parts),  # they take most of the time of an upload
            **{f"UNBEND_{name.upper()}": str(value) for name, value in settings.items()},
        )
        command = [
            *within,
            sys.executable,
            "-m",
            "unbend",
            self.command,
            "--port",
            str(port),
            "--host",
            host,
            "--library",
            library or str(self.library),
        ]
        with self.log.open("wb") as log:
            self.process = subprocess.Popen(
                [*command, "--workers", str(workers)], stderr=log, stdout=log, env=environment, cwd=folder
            )
        try:
            self.url = self._address()
            if ready:
                self._until_ready()
        except BaseException:
            self.stop()
            raise

    def __enter__(self) -> Server:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def http(self) -> httpx.Client:
        """Return a client with a new connection for every request, so that no request affects the next."""
        return httpx.Client(base_url=self.url, timeout=90.0, limits=httpx.Limits(max_keepalive_connections=0))

    def workers(self) -> list[int]:
        return workers_of(self.process.pid)

    def stop(self) -> None:
        """Stop the server; kill it and its workers if it does not end."""
        workers = self.workers()
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
        try:
            self.process.wait(40)
        except subprocess.TimeoutExpired:
            self.kill()
        for pid in filter(is_running, workers):
            os.kill(pid, signal.SIGKILL)
        if self._own_temporary:
            shutil.rmtree(self.temporary, ignore_errors=True)

    def kill(self) -> None:
        """Kill the server."""
        self.process.kill()
        self.process.wait()

    def _address(self) -> str:
        def find() -> str | None:
            found = re.search(r"running on (http://[\d.]+:\d+)", self.log.read_text())
            return found.group(1) if found else None

        return self._wait_for(find, "start")

    def _until_ready(self) -> None:
        self._wait_for(
            lambda: httpx.get(f"{self.url}{self.prefix}/readyz", timeout=60.0).is_success or None, "become ready"
        )

    def _wait_for(self, find: Callable[[], T | None], purpose: str) -> T:
        """Poll while the server and its workers use CPU time, because a busy machine slows them down."""
        begun = progressed = time.monotonic()
        used = 0.0
        while self.process.poll() is None and time.monotonic() - begun < LONGEST_SECONDS:
            if (found := find()) is not None:
                return found
            now_used = sum(cpu_seconds(pid) for pid in (self.process.pid, *self.workers()))
            if now_used > used:
                used, progressed = now_used, time.monotonic()
            elif time.monotonic() - progressed > IDLE_SECONDS:
                break
            time.sleep(0.05)
        raise RuntimeError(f"the server did not {purpose}:\n{self.log.read_text()}")


class Worker(Server):
    """`unbend worker` on this machine, ready after its construction."""

    command = "worker"
    prefix = ""


def post_mesh(http: httpx.Client, data: bytes, *, file_name: str = "mesh.ply", **fields: str) -> httpx.Response:
    return http.post("/v1/shapes", files={"file": (file_name, data)}, data=fields)


def ended(http: httpx.Client, response: httpx.Response) -> dict:
    """Wait for the end of an upload's job, and return the job."""
    assert response.status_code == httpx.codes.ACCEPTED, response.text
    while True:
        job = http.get(response.headers["Location"], params={"wait": 30}).raise_for_status().json()
        if job["state"] not in {"queued", "running"}:
            return job


def stored(http: httpx.Client, data: bytes, *, file_name: str = "mesh.ply", **fields: str) -> dict:
    """Upload a mesh, wait for its job, and return the record of the shape."""
    response = post_mesh(http, data, file_name=file_name, **fields)
    if response.status_code == httpx.codes.OK:
        return response.json()
    job = ended(http, response)
    assert job["state"] == "succeeded", job
    return http.get(f"/v1/shapes/{job['shape_id']}").raise_for_status().json()
