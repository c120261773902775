"""The session of one method in its own process: opens a mesh, computes rows, and times them."""

from __future__ import annotations

import ctypes
import gc
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.geodesics.peers import Array, Method


@dataclass(frozen=True)
class Timing:
    """The time of a row, of a matrix or of the preparation."""

    seconds: float
    cores: float
    """Processor time over wall time."""


@dataclass(frozen=True)
class Opened:
    """The costs of preparing a mesh and of a first row, in a process that has run the method on a small mesh before."""

    preparation: Timing
    row: Timing
    vertices: int
    mesh_bytes: int
    """Memory of the mesh in the method's own format."""
    peak_bytes: int
    """Peak memory of preparing and of the row, beyond the libraries and the mesh."""


class Session:
    """A method and the mesh opened last. The parent process can call every public function."""

    def __init__(self, method: Method, small_mesh: str) -> None:
        self.method = method
        self.mesh: Any = None
        self.state: Any = None
        self.vertices = 0
        self.open(small_mesh)  # so that compilation and lazy loading are not timed later

    def open(self, path: str) -> Opened:
        """Load a mesh, prepare it and compute one row."""
        self.state = self.mesh = None
        before = _settled_memory()
        self._load(path)
        loaded = _settled_memory()
        preparation = self._prepare()
        row = _timed(lambda: self.method.row(self.state, 0))
        return Opened(preparation, row, self.vertices, loaded - before, _memory("VmHWM") - loaded)

    def reopen(self, path: str) -> float:
        """Load the mesh again and prepare it; return the seconds of the preparation."""
        self._load(path)
        return self._prepare().seconds

    def rows(self, sources: Sequence[int]) -> Array:
        """Return distances from each of `sources`."""
        return self.method.rows(self.state, sources, 1)

    def time_many(self, sources: Sequence[int], threads: int | None) -> Timing:
        """Return the time of a row when one call computes all rows; of two calls, the quicker counts."""
        calls = [_timed(lambda: self.method.rows(self.state, sources, threads)) for _ in range(2)]
        quickest = min(calls, key=lambda timing: timing.seconds)
        return Timing(quickest.seconds / len(sources), quickest.cores)

    def time_alone(self, sources: Sequence[int], budget: float) -> Timing:
        """Return the median time of a row when each row is its own call, over the rows that fit into `budget` seconds.

        The median ignores rows during which the machine was busy with something else.
        """
        rows: list[Timing] = []
        stop = time.perf_counter() + budget
        while not rows or time.perf_counter() < stop:
            source = sources[len(rows) % len(sources)]
            rows.append(_timed(lambda: self.method.row(self.state, source)))  # noqa: B023 - called at once
        return sorted(rows, key=lambda timing: timing.seconds)[len(rows) // 2]

    def time_matrix(self, samples: Sequence[int], threads: int | None) -> Timing:
        """Return the time of the matrix between `samples`."""
        return _timed(lambda: self.method.matrix(self.state, np.asarray(samples), threads))

    def _load(self, path: str) -> None:
        with np.load(path) as arrays:
            self.mesh = self.method.load(arrays["vertices"], arrays["faces"])
            self.vertices = len(arrays["vertices"])

    def _prepare(self) -> Timing:
        self.state = None
        return _timed(lambda: setattr(self, "state", self.method.prepare(self.mesh)))


def _timed(function: Callable[[], object]) -> Timing:
    wall, processor = time.perf_counter(), time.process_time()
    function()
    wall, processor = time.perf_counter() - wall, time.process_time() - processor
    return Timing(wall, processor / wall)


def _settled_memory() -> int:
    """Return free memory to the system, reset the peak, and return the memory in use (Linux only)."""
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    Path("/proc/self/clear_refs").write_text("5")
    return _memory("VmRSS")


def _memory(field: str) -> int:
    # Not ru_maxrss, which a process inherits from its parent.
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith(field))
