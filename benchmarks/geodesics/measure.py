"""Measures all methods on one mesh in turns, so that a disturbance of the machine affects all of them."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.geodesics.meshes import Mesh
from benchmarks.geodesics.peers import EXACT, EXACTS, METHODS, OURS, Array
from benchmarks.geodesics.session import Opened, Timing
from benchmarks.geodesics.worker import PeerFailedError, Worker
from unbend import farthest_point_sampling

ERROR_SOURCES = 8
TIMED_SOURCES = 32
MATRIX_SIZE = 300
_ROUND_SECONDS = 0.4  # time budget of one method in a round
_SLOW_SECONDS = 0.5  # a row or a preparation that takes longer is not measured again
_SLOW_MATRIX_SECONDS = 3.0

Error = tuple[float, float]
"""Mean and largest relative error, in percent."""


@dataclass
class Result:
    """The measurements of one method on one mesh; a string in place of a number says why the number is missing."""

    opened: Opened | str = "-"
    error: Error | str = "-"
    preparation: float | str = "-"
    alone: Timing | str = "-"
    many: Timing | str = "-"
    all_threads: Timing | str = "-"
    matrix: Timing | str = "-"
    matrix_all_threads: Timing | str = "-"


class Bench:
    """The workers of all methods, and their results on one mesh."""

    def __init__(self, mesh: Mesh, workers: dict[str, Worker]) -> None:
        self.mesh = mesh
        self.workers = workers
        self.results = {name: Result() for name in workers}
        self.timed_sources = mesh.spread(TIMED_SOURCES)

    def attempt(self, name: str, command: str, *arguments: object) -> Any:
        """Return the answer of a worker, or the reason for its failure as a string."""
        try:
            return self.workers[name].call(command, *arguments)
        except PeerFailedError as failure:
            return str(failure)

    def open(self) -> None:
        """Prepare the mesh once with each method, in its fresh process."""
        for name, result in self.results.items():
            result.opened = self.attempt(name, "open", str(self.mesh.path))
            if isinstance(result.opened, str):
                result.preparation = result.alone = result.opened
                continue
            result.preparation = result.opened.preparation.seconds
            if result.opened.row.seconds > _SLOW_SECONDS:
                result.alone = result.opened.row

    def errors(self) -> None:
        """Measure the errors of all methods against exact distances."""
        sources = self.mesh.spread(ERROR_SOURCES)
        exact = self.attempt(EXACT, "rows", sources)
        for name, result in self.results.items():
            if name == EXACT or (name in EXACTS and self.mesh.count > 10_000):
                continue
            asked = sources[:1] if name in EXACTS else sources
            result.error = error_of(self.attempt(name, "rows", asked), exact)

    def round(self) -> None:
        """Time every method once, in turn, and keep the best time of all rounds so far."""
        for name, result in self.results.items():
            if not _is_slow(result.alone, _SLOW_SECONDS):
                alone = self.attempt(name, "time_alone", self.timed_sources, _ROUND_SECONDS)
                result.alone = better(result.alone, alone)
            if name in OURS:
                one, every = (self.attempt(name, "time_many", self.timed_sources, threads) for threads in (1, None))
                result.many, result.all_threads = better(result.many, one), better(result.all_threads, every)
            if isinstance(result.preparation, float) and result.preparation < _SLOW_SECONDS:
                again = self.attempt(name, "reopen", str(self.mesh.path))
                result.preparation = again if isinstance(again, str) else min(again, result.preparation)

    def matrices(self) -> None:
        """Time the matrix between farthest point samples; for exact methods, extrapolate from the time of a row."""
        samples = farthest_point_sampling(self.mesh.surface, MATRIX_SIZE).tolist()
        for name, result in self.results.items():
            if name in EXACTS:
                rows = result.alone
                result.matrix = rows if isinstance(rows, str) else Timing(rows.seconds * MATRIX_SIZE, rows.cores)
                continue
            if not _is_slow(result.matrix, _SLOW_MATRIX_SECONDS):
                result.matrix = better(result.matrix, self.attempt(name, "time_matrix", samples, 1))
            if name in OURS:
                every = self.attempt(name, "time_matrix", samples, None)
                result.matrix_all_threads = better(result.matrix_all_threads, every)


def measure(mesh: Mesh, small: Mesh, rounds: int, *, matrices: bool) -> dict[str, Result]:
    """Measure all methods on `mesh`."""
    with ExitStack() as stack:
        bench = Bench(mesh, start_workers(stack, list(METHODS), small.path))
        bench.open()
        bench.errors()
        for _ in range(rounds):
            bench.round()
        for _ in range(2 if matrices else 0):
            bench.matrices()
        return {name: _without_row(name, result) for name, result in bench.results.items()}


def start_workers(stack: ExitStack, names: list[str], small_mesh: Path) -> dict[str, Worker]:
    """Start one process for each method, all at once, and return when all have imported their libraries."""
    workers = {name: stack.enter_context(Worker(name, small_mesh)) for name in names}
    for worker in workers.values():
        try:
            worker.wait_until_ready()
        except PeerFailedError:
            continue  # the first call raises the same error
    return workers


def error_of(distances: Array | str, exact: Array | str) -> Error | str:
    """Return the relative error of rows of distances, or a string that says what is wrong with the rows."""
    if isinstance(distances, str):
        return distances
    if isinstance(exact, str):
        return f"exact: {exact}"
    exact = exact[: len(distances)]
    if distances.shape != exact.shape:
        return f"{distances.shape[-1]} values"
    known = (exact > 0) & np.isfinite(exact)
    relative = 100 * np.abs(distances[known] - exact[known]) / exact[known]
    if not np.isfinite(relative).all():
        return f"{1 - np.isfinite(relative).mean():.0%} not finite"
    return float(relative.mean()), float(relative.max())


def better(old: Timing | str, new: Timing | str) -> Timing | str:
    """Return the quicker of two timings, or a failure if neither is a timing."""
    if isinstance(old, str) or isinstance(new, str):
        return new if isinstance(old, str) else old
    return min(old, new, key=lambda timing: timing.seconds)


def _is_slow(timing: Timing | str, limit: float) -> bool:
    return isinstance(timing, Timing) and timing.seconds > limit


def _without_row(name: str, result: Result) -> Result:
    if name in OURS and isinstance(result.preparation, float) and isinstance(result.alone, Timing):
        result.preparation = max(0.0, result.preparation - result.alone.seconds)
    return result
