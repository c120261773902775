"""Imports many small files, interrupts the import, resumes it, and measures its memory.

    python -m benchmarks.service.importing [FILES]

Makes FILES distinct meshes (100,000 by default) in a temporary folder and imports them on all cores into one library.
The first import gets SIGINT, the second SIGKILL, the third runs to the end, and the fourth finds every file known.
Writes the section "importing" of docs/reliability.md. Exits with status 1 if there was a fault.
"""

from __future__ import annotations

import argparse
import csv
import re
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np

from benchmarks.common import ROOT, table, write_section
from tests.support.footprint import Footprint, footprint
from tests.support.server import without_settings, workers_of
from unbend import Library
from unbend.mesh.shapes import torus
from unbend.mesh.write import write_mesh
from unbend.threads import available_cores

PAGE: Final = ROOT / "docs" / "reliability.md"
OPTIONS: Final = ("--samples", "8", "--method", "classical", "--without-parts", "--label-from", "folder")
IN_A_FOLDER: Final = 1000
SHARES: Final = (0.1, 0.25, 0.5, 0.75, 1.0)
INTERRUPTED_AT: Final = 0.02
KILLED_AT: Final = 0.04
POLL_SECONDS: Final = 0.2
MEGABYTE: Final = 2**20
GROWTH: Final = 1.10
"""Largest allowed memory of all processes at the end, relative to that at the first of `SHARES`."""


@dataclass
class Run:
    """One import: the rows of its report, its end, and the memory of its processes."""

    rows: list[dict[str, str]] = field(default_factory=list)
    status: int = 0
    errors: str = ""
    seconds: float = 0.0
    end_seconds: float = 0.0
    """Time from the signal to the end of the last process."""
    samples: list[tuple[float, Footprint, Footprint]] = field(default_factory=list)
    """Share of the files that ended; the command's own process; the workers together."""

    def paths(self, outcome: str) -> list[str]:
        return [row["path"] for row in self.rows if row["outcome"] == outcome]


def make_meshes(folder: Path, count: int) -> None:
    """Write tori of 15 vertices and 30 triangles, each perturbed in another way."""
    surface, random = torus(columns=5, rows=3), np.random.default_rng(1)
    for number in range(count):
        place = folder / f"{number // IN_A_FOLDER:03d}"
        place.mkdir(exist_ok=True)
        vertices = surface.vertices + random.normal(scale=0.02, size=surface.vertices.shape)
        (place / f"{number:06d}.ply").write_bytes(write_mesh(vertices, surface.faces, "ply"))


def run_import(folder: Path, library: Path, count: int, *, stop: tuple[signal.Signals, float] | None = None) -> Run:
    """Import a folder, and send a signal to the command when its report has a share of the files."""
    run, report = Run(), library.with_suffix(".csv")
    report.unlink(missing_ok=True)
    command = [sys.executable, "-m", "unbend", "import", str(folder), "--library", str(library)]
    errors = library.with_suffix(".log")
    began = time.monotonic()
    with errors.open("wb") as log, subprocess.Popen(
        [*command, *OPTIONS, "--report", str(report)], stderr=log, stdout=log, env=without_settings()
    ) as process:  # fmt: skip
        rows = _count_rows(report)
        while process.poll() is None:
            share = next(rows) / count
            workers = workers_of(process.pid)
            run.samples += _sample(share, process.pid, workers) if workers else []
            if stop and share >= stop[1]:
                run.end_seconds = _stop(process, workers, stop[0])
                break
            time.sleep(POLL_SECONDS)
    run.seconds, run.status, run.errors = time.monotonic() - began, process.returncode, errors.read_text()
    with report.open(newline="") as file:
        run.rows = list(csv.DictReader(file))
    return run


def _count_rows(report: Path) -> Iterator[int]:
    """Yield the number of rows so far, again and again; read each byte once."""
    while not report.exists():
        yield 0
    with report.open("rb") as file:
        count = 0
        while True:
            count += file.read().count(b"\n")
            yield max(0, count - 1)


def _sample(share: float, pid: int, workers: Sequence[int]) -> list[tuple[float, Footprint, Footprint]]:
    try:
        parts = [footprint(worker) for worker in workers]
        fields = ("resident", "own", "handles", "threads")
        together = Footprint(*(sum(getattr(part, name) for part in parts) for name in fields))
        return [(share, footprint(pid), together)]
    except (OSError, KeyError, IndexError):  # a process has just ended
        return []


def _stop(process: subprocess.Popen[bytes], workers: Sequence[int], number: signal.Signals) -> float:
    """Send a signal, and return the seconds until the command and its workers have ended."""
    sent = time.monotonic()
    process.send_signal(number)
    process.wait()
    while any(Path(f"/proc/{pid}").exists() for pid in workers):
        time.sleep(0.01)
    return time.monotonic() - sent


def find_faults(runs: Sequence[Run], count: int, before_third: int, stored: int) -> list[str]:
    """Return what is wrong with the four imports."""
    interrupted, killed, complete, again = runs
    faults = [
        (interrupted.status != 130, f"SIGINT: the status is {interrupted.status}"),
        ("interrupted" not in interrupted.errors, "SIGINT: no sentence says so"),
        (killed.status != -signal.SIGKILL, f"SIGKILL: the status is {killed.status}"),
        (complete.status != 0 or again.status != 0, f"an import failed: {complete.errors}{again.errors}"),
        (stored != count, f"the library has {stored} shapes"),
        (len(complete.paths("unchanged")) != before_third, "the third import computed what was stored"),
        (len(complete.paths("new")) != count - before_third, "the third import did not compute all others"),
        (len(again.paths("unchanged")) != count, "the fourth import computed something"),
    ]
    found = [text for is_wrong, text in faults if is_wrong]
    new = Counter(path for run in runs for path in run.paths("new"))
    found += [f"{path} was computed {times} times" for path, times in new.items() if times > 1]
    for run in (complete, again):
        if len({row["path"] for row in run.rows}) != count or len(run.rows) != count:
            found.append("a report has not one row for each file")
        numbers = [int(text.replace(",", "")) for text in re.findall(r"^ +([\d,]+) ", run.errors, re.MULTILINE)]
        if numbers[0] != count or sum(numbers[1:]) != count:
            found.append(f"the counts do not add up: {numbers}")
    memory = [_memory_at(complete, share) for share in (SHARES[0], SHARES[-1])]
    if memory[1] > GROWTH * memory[0]:
        found.append(f"memory grew from {memory[0] / MEGABYTE:.0f} to {memory[1] / MEGABYTE:.0f} MB")
    return found


def _at(run: Run, share: float) -> tuple[float, Footprint, Footprint]:
    """Return the first sample at or after a share of the files, or the last one."""
    return next((sample for sample in run.samples if sample[0] >= share), run.samples[-1])


def _memory_at(run: Run, share: float) -> int:
    _, command, workers = _at(run, share)
    return command.resident + workers.resident


def describe(runs: Sequence[Run], count: int, size: int, faults: int) -> str:
    """Return the section of the page."""
    interrupted, killed, complete, again = runs
    rows = []
    for share in SHARES:
        _, command, workers = _at(complete, share)
        sums = (command.resident, workers.resident, command.resident + workers.resident, command.own + workers.own)
        rows.append([f"{share:.0%}", *(f"{memory / MEGABYTE:.0f}" for memory in sums)])
    peak = max(_memory_at(complete, sample[0]) for sample in complete.samples) / MEGABYTE
    header = ["files", "the command, MB", "its workers, MB", "together, MB", "private, MB"]
    new = len(complete.paths("new"))
    return f"""\
{count:,} distinct meshes of 15 vertices and 30 triangles, imported by {available_cores()} processes with `{" ".join(OPTIONS)}`. The first import got SIGINT after {len(interrupted.rows):,} files and ended {interrupted.end_seconds:.1f} s later with status {interrupted.status}. The second got SIGKILL after {len(killed.rows):,} files, and its workers ended {killed.end_seconds:.1f} s later. The third computed the other {new:,} files, {new / complete.seconds:.0f} a second. The fourth found every file known, {count / again.seconds:.0f} a second. The library has {size / count / 1024:.1f} kB per shape.

Resident memory of the third import, after each share of the files (private: memory that no other process shares; peak: {peak:.0f} MB together):

{table(header, rows)}

Faults (a file that was computed again although it was stored, a file without its row in a report, counts that do not add up, a shape that is missing, more than {GROWTH - 1:.0%} more memory at the end than after {SHARES[0]:.0%}): {faults}."""  # noqa: E501


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="?", type=int, default=100_000)
    count = parser.parse_args().files
    # A shell lets commands in the background ignore SIGINT, and the imports would inherit that.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    with TemporaryDirectory() as temporary:
        folder, library = Path(temporary) / "meshes", Path(temporary) / "library.db"
        folder.mkdir()
        make_meshes(folder, count)
        runs = [
            run_import(folder, library, count, stop=(signal.SIGINT, INTERRUPTED_AT)),
            run_import(folder, library, count, stop=(signal.SIGKILL, KILLED_AT)),
        ]
        with Library(str(library)) as opened:
            before_third = len(opened)
        for _ in range(2):
            runs.append(run_import(folder, library, count))  # noqa: PERF401
        with Library(str(library)) as opened:
            stored = len(opened)
        faults = find_faults(runs, count, before_third, stored)
        write_section(PAGE, "importing", describe(runs, count, library.stat().st_size, len(faults)))
    for fault in faults:
        print(fault, file=sys.stderr)
    sys.exit(int(bool(faults)))


if __name__ == "__main__":
    main()
