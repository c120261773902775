"""Kills real servers under load, one after another on one library, and checks the library against acknowledgements."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import sqlite3
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import mkdtemp

import numpy as np

from tests.support.footprint import processes_with
from tests.support.load import Caller, in_threads
from tests.support.server import LONGEST_SECONDS, Server

_PROCESSES_END_SECONDS = 20.0


@dataclass(frozen=True)
class Crash:
    """The measurements of one server that was started, called, and killed."""

    start_seconds: float
    """Time from the start of the server to its first answer."""
    ready: bool
    """Whether the workers had loaded their kernels before the kill."""
    acknowledged: int
    """Jobs that the server acknowledged."""
    left_seconds: float
    """Time from the kill to the end of the last process of the server."""
    left_folders: int
    """Temporary files and folders of earlier servers that were still there after the start of this server."""


class Crashes:
    """A library whose servers are killed, and clients that remember the acknowledgements of the servers."""

    def __init__(self, folder: Path, seed: int, *, callers: int = 4) -> None:
        self.callers = [Caller(number, seed) for number in range(callers)]
        self._folder = folder
        self._temporary = Path(mkdtemp(prefix="unbend-"))
        self._random = np.random.default_rng(seed)
        self._faults: list[str] = []

    @property
    def faults(self) -> list[str]:
        """All faults found so far."""
        return self._faults + [fault for caller in self.callers for fault in caller.faults]

    def crash(self, *, early: bool = False) -> Crash:
        """Start a server, check it, call it from all clients, and kill it; if `early`, before its workers are ready."""
        start, before = time.monotonic(), self._acknowledged()
        with Server(self._folder, ready=False, temporary=self._temporary) as server:
            started = time.monotonic() - start
            folders = self._check(server)
            with self._calls(server):
                if not early:
                    self._until_ready(server)
                time.sleep(self._random.uniform(0.2, 2.0))
                ready = self._is_ready(server)
                server.kill()
            killed = time.monotonic()
            self._until_processes_end(server)
            ended = time.monotonic() - killed
        return Crash(started, ready, self._acknowledged() - before, ended, folders)

    def finish(self) -> None:
        """Start a last server, wait until all jobs have ended, and check everything."""
        with Server(self._folder, temporary=self._temporary) as server:
            in_threads(lambda caller=caller: caller.settle(server.url) for caller in self.callers)
            self._check(server, everything=True)
        shutil.rmtree(self._temporary)

    def _check(self, server: Server, *, everything: bool = False) -> int:
        for caller in self.callers:
            caller.check(server.url, everything=everything)
        with contextlib.closing(sqlite3.connect(server.library)) as connection:
            found = connection.execute("PRAGMA integrity_check").fetchall()
            dangling = connection.execute("PRAGMA foreign_key_check").fetchall()
        if found != [("ok",)] or dangling:
            self._faults.append(f"the library is damaged: {found} {dangling}")
        left = leftovers(server.temporary)
        if left:
            self._faults.append(f"temporary files and folders are left: {', '.join(path.name for path in left)}")
        return len(left)

    @contextlib.contextmanager
    def _calls(self, server: Server) -> Iterator[None]:
        calling = threading.Event()
        calling.set()
        threads = [
            threading.Thread(target=caller.run, args=(server.url, calling.is_set), name=f"caller {number}")
            for number, caller in enumerate(self.callers)
        ]
        for thread in threads:
            thread.start()
        try:
            yield
        finally:
            calling.clear()
            for thread in threads:
                thread.join()

    def _until_ready(self, server: Server) -> None:
        end = time.monotonic() + LONGEST_SECONDS
        while not self._is_ready(server) and time.monotonic() < end:
            time.sleep(0.05)

    def _is_ready(self, server: Server) -> bool:
        with server.http() as http:
            return http.get("/v1/readyz").is_success

    def _until_processes_end(self, server: Server) -> None:
        end = time.monotonic() + _PROCESSES_END_SECONDS
        while left := processes_with(f"TMPDIR={server.temporary}"):
            if time.monotonic() > end:
                self._faults.append(f"{len(left)} processes of a killed server live on")
                for pid in left:
                    os.kill(pid, signal.SIGKILL)
                return
            time.sleep(0.02)

    def _acknowledged(self) -> int:
        return sum(caller.acknowledged for caller in self.callers)


def leftovers(folder: Path) -> list[Path]:
    """Return the temporary files and folders that killed servers left, without the empty files of SQLite.

    The folder with the socket of a fork server that runs is not among them.

    SQLite creates a temporary file named `etilqs_*` and unlinks it at once. A kill between the two steps leaves an
    empty file, which this package cannot prevent.
    """
    sockets = Path("/proc/net/unix").read_text()
    return [path for path in folder.iterdir() if not _is_of_sqlite(path) and f"{path}/" not in sockets]


def _is_of_sqlite(path: Path) -> bool:
    if not path.name.startswith("etilqs_"):
        return False
    try:
        return path.stat().st_size == 0
    except FileNotFoundError:  # SQLite has just unlinked the file
        return True
