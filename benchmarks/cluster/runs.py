"""The table of jobs that both engines run, and the worker processes that run them."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass
from typing import Protocol

from sqlalchemy import Connection

from benchmarks.common import ROOT

SCHEMA = """
    CREATE TABLE runs (
        id bigserial PRIMARY KEY, engine_id text, starts float8[] DEFAULT '{}', seen float8, ended float8
    )
"""
ADD = "INSERT INTO runs DEFAULT VALUES RETURNING id"
NAME = "UPDATE runs SET engine_id = %s WHERE id = %s"
BEGIN = "UPDATE runs SET starts = starts || %s::float8 WHERE id = %s"
END = "UPDATE runs SET starts = starts || %s::float8[], ended = %s WHERE id = %s"
TELL = "SELECT pg_notify('runs', %s::text)"
SEE = "UPDATE runs SET seen = %s WHERE id = %s"


class Engine(Protocol):
    """An engine in the process that submits jobs."""

    name: str

    def install(self) -> None:
        """Create the engine's tables."""

    def submit(self, connection: Connection, seconds: float, priority: int = 0) -> int:
        """Add a row of `runs` and its job in the caller's transaction; return the row's id."""

    def cancel(self, run_id: int) -> None:
        """Cancel a job, running or not."""

    def clear(self) -> None:
        """Delete all jobs; no worker may run."""

    def close(self) -> None:
        """Close all connections."""


@dataclass(frozen=True)
class Setting:
    """How workers run."""

    engine: str
    url: str
    slots: int = 4
    name: str = "worker"
    poll: float = 5.0
    """Seconds between two looks at the queue."""
    quick: bool = False
    """Whether the engine's connections are set up for speed."""


class Worker:
    """A worker process."""

    def __init__(self, setting: Setting) -> None:
        command = [sys.executable, "-m", "benchmarks.cluster.worker", setting.engine, setting.url]
        command += [str(setting.slots), setting.name, str(setting.poll), str(int(setting.quick))]
        self._process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
        self._output = self._process.stdout
        if self._output is None or self._output.readline() != "ready\n":
            raise RuntimeError(f"a worker of {setting.engine} does not start")

    def kill(self) -> None:
        """End the process with SIGKILL."""
        self._process.kill()
        self._close()

    def stop(self) -> None:
        """End the process with SIGTERM."""
        self._process.terminate()
        self._close()

    def _close(self) -> None:
        self._process.wait(30)
        if self._output:
            self._output.close()
