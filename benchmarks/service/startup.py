"""Times how long commands take to start, as ratios to what they must import in any case.

    python -m benchmarks.service.startup [RUNS]

Runs each command and its comparison in turns, RUNS times (9 by default), and compares the medians. Kernels are compiled
before. Writes the section "startup" of docs/benchmarks/start.md.
"""

from __future__ import annotations

import os
import re
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import httpx

from benchmarks.common import ROOT, table, write_section
from tests.support.server import without_settings
from unbend.jobs.worker import warm_up

PAGE: Final = ROOT / "docs" / "benchmarks" / "start.md"
RUNS: Final = 9
DEPENDENCIES: Final = (
    "alembic, click, fastapi, fast_simplification, httpx, numba, numpy, prometheus_client, pydantic_settings, "
    "scipy.linalg, scipy.sparse.csgraph, sqlalchemy, uvicorn"
)
"""The modules of dependencies that a starting server and its workers import."""


@dataclass(frozen=True)
class Comparison:
    """A command, what it is compared with, and the largest ratio that we ask for."""

    name: str
    ours: Callable[[], float]
    base_name: str
    base: Callable[[], float]
    asked: str


def main() -> None:
    runs = int(sys.argv[1]) if sys.argv[1:] else RUNS
    warm_up()
    with TemporaryDirectory(prefix="unbend-startup-") as name:
        library = Path(name, "library.db")
        imports, dependencies = "importing its dependencies", python(f"import {DEPENDENCIES}")
        worker = "from unbend.jobs.worker import warm_up"
        comparisons = (
            Comparison("`import unbend`", python("import unbend"), "`import numpy`", python("import numpy"), "1.3"),
            Comparison("`unbend --help`", command("unbend", "--help"), "`import click`", python("import click"), "3"),
            Comparison("`unbend serve` until `/v1/readyz`", lambda: until_ready(library), imports, dependencies, "2"),
            Comparison("part: the imports of a server", python("import unbend.api"), imports, dependencies, ""),
            Comparison("part: the imports of a worker", python(worker), imports, dependencies, ""),
            Comparison(
                "part: a worker's imports and kernels", python(f"{worker}; warm_up()"), imports, dependencies, ""
            ),
        )
        rows = [row(comparison, runs) for comparison in comparisons]
    lines = [
        f"Medians of {runs} alternating runs on {os.cpu_count()} cores, in seconds, each of a new process.",
        "",
        table(["Command", "s", "Compared with", "s", "Ratio", "Asked: at most"], rows),
    ]
    write_section(PAGE, "startup", "\n".join(lines))


def row(comparison: Comparison, runs: int) -> tuple[str, ...]:
    comparison.ours(), comparison.base()  # fill the caches of the system
    ours, base = zip(*((comparison.ours(), comparison.base()) for _ in range(runs)), strict=True)
    first, second = statistics.median(ours), statistics.median(base)
    return (
        comparison.name, f"{first:.2f}", comparison.base_name, f"{second:.2f}", f"{first / second:.2f}",
        comparison.asked,
    )  # fmt: skip


def python(code: str) -> Callable[[], float]:
    return timed([sys.executable, "-c", code])


def command(*arguments: str) -> Callable[[], float]:
    return timed([sys.executable, "-c", "from unbend.cli import main; main()", *arguments[1:]])


def timed(arguments: Sequence[str]) -> Callable[[], float]:
    def run() -> float:
        begun = time.perf_counter()
        subprocess.run(arguments, stdout=subprocess.DEVNULL, check=True)
        return time.perf_counter() - begun

    return run


def until_ready(library: Path) -> float:
    """Start a server of one worker for each core on an existing library, and return the seconds until it is ready."""
    log = library.with_suffix(".log")
    begun = time.perf_counter()
    with log.open("wb") as stream:
        process = subprocess.Popen(
            [sys.executable, "-m", "unbend", "serve", "--port", "0", "--library", str(library)],
            env=without_settings(),
            stdout=stream,
            stderr=stream,
        )
    try:
        while not (address := re.search(r"running on (http://[\d.:]+)", log.read_text())):
            if process.poll() is not None:
                raise RuntimeError(log.read_text())
            time.sleep(0.01)
        while not httpx.get(f"{address[1]}/v1/readyz", trust_env=False).is_success:
            time.sleep(0.01)
        return time.perf_counter() - begun
    finally:
        process.terminate()
        process.wait()


if __name__ == "__main__":
    main()
