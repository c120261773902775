"""Computes many small files in shards, kills each shard once, imports the results, and measures time and memory.

    python -m benchmarks.service.shards [FILES]

Makes FILES distinct meshes (20,000 by default) in a temporary folder and computes them by `unbend compute` in SHARDS
shards, one after the other. Each gets SIGKILL halfway, and the same command continues. `unbend import` then stores all
results in a library, and a second time finds them known. Writes the section "shards" of docs/reliability.md. Exits with
status 1 if there was a fault.
"""

from __future__ import annotations

import argparse
import csv
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from benchmarks.common import table, write_section
from benchmarks.service.importing import MEGABYTE, OPTIONS, PAGE, POLL_SECONDS, make_meshes
from tests.support.footprint import footprint
from tests.support.server import without_settings
from unbend import Library
from unbend.threads import available_cores

SHARDS: Final = 4
COMMAND: Final = [sys.executable, "-m", "unbend"]
GROWTH: Final = 1.10
"""Largest allowed memory of the import at the end, relative to that when a tenth of the files is stored."""

NO_FAULT: Final = (
    "a command that failed, a result that was lost, a shape that is missing, more than "
    f"{GROWTH - 1:.0%} more memory of the import at the end than after a tenth"
)


@dataclass
class Run:
    """One command: the outcomes of its files, its time, and the resident bytes of its own process."""

    rows: list[str] = field(default_factory=list)
    status: int = 0
    seconds: float = 0.0
    memory: list[tuple[int, int]] = field(default_factory=list)
    """Files that had ended, and resident bytes, from time to time."""

    def count(self, outcome: str) -> int:
        return self.rows.count(outcome)

    @property
    def peak(self) -> int:
        return max(size for _, size in self.memory)


def run(arguments: Sequence[object], report: Path, kill_at: int | None = None) -> Run:
    """Run a command, and kill it once its report has so many files."""
    found, began = Run(), time.monotonic()
    report.unlink(missing_ok=True)
    command = [*COMMAND, *map(str, arguments), "--report", str(report)]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL, env=without_settings()) as own:
        while own.poll() is None:
            ended = _rows(report)
            if memory := _resident(own.pid):
                found.memory.append((ended, memory))
            if kill_at is not None and ended >= kill_at:
                own.kill()
            time.sleep(POLL_SECONDS)
    found.seconds, found.status = time.monotonic() - began, own.returncode
    with report.open(newline="") as file:
        found.rows = [row["outcome"] for row in csv.DictReader(file)]
    return found


def _rows(report: Path) -> int:
    return max(0, report.read_bytes().count(b"\n") - 1) if report.exists() else 0


def _resident(pid: int) -> int:
    try:
        return footprint(pid).resident
    except (OSError, KeyError, IndexError):  # the process has just ended
        return 0


def describe(killed: Sequence[Run], resumed: Sequence[Run], imports: Sequence[Run], sizes: Sequence[int]) -> str:
    """Return the section of the page."""
    computed = sum(one.count("new") for one in resumed)
    seconds = sum(one.seconds for one in resumed)
    kept = sum(one.count("unchanged") for one in resumed)
    stored, again = imports
    count = len(stored.rows)
    first = next(size for ended, size in stored.memory if ended >= count / 10)
    rows = [
        ["computed after a kill, all shards", f"{computed:,}", f"{computed / seconds:.0f}",
         f"{max(one.peak for one in resumed) / MEGABYTE:.0f}"],
        ["imported", f"{stored.count('new'):,}", f"{count / stored.seconds:.0f}", f"{stored.peak / MEGABYTE:.0f}"],
        ["imported again", f"{again.count('unchanged'):,}", f"{count / again.seconds:.0f}",
         f"{again.peak / MEGABYTE:.0f}"],
    ]  # fmt: skip
    options = " ".join(OPTIONS)
    return f"""\
{count:,} distinct meshes of 15 vertices and 30 triangles, computed in {SHARDS} shards, one after the other, by {available_cores()} processes with `{options}`. Each got SIGKILL after half of its files, {sum(len(one.rows) for one in killed):,} together, and the second run found {kept:,} of them. A shape has {sizes[0] / count / 1024:.1f} kB in the shards, its mesh included, and {sizes[1] / count / 1024:.1f} kB in the library.

{table(["step", "files", "files a second, with the start", "peak memory of the command, MB"], rows)}

The import had {first / MEGABYTE:.0f} MB when a tenth of the files was stored."""  # noqa: E501


def find_faults(
    killed: Sequence[Run], resumed: Sequence[Run], imports: Sequence[Run], count: int, shapes: int
) -> list[str]:
    """Return what is wrong."""
    stored, again = imports
    first = next(size for ended, size in stored.memory if ended >= count / 10)
    checks = [
        (any(one.status != -9 for one in killed), "a shard ended before it was killed"),
        (any(one.status for one in (*resumed, *imports)), "a command failed"),
        (sum(len(one.rows) for one in resumed) != count, "the shards do not have all files"),
        (any(b.count("unchanged") < len(a.rows) for a, b in zip(killed, resumed, strict=True)), "a result was lost"),
        (stored.count("new") != count or shapes != count, "the import did not store all shapes"),
        (again.count("unchanged") != count, "the second import stored something"),
        (stored.peak > GROWTH * first, "the memory of the import grew"),
    ]
    return [text for is_wrong, text in checks if is_wrong]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="?", type=int, default=20_000)
    count = parser.parse_args().files
    with TemporaryDirectory() as temporary:
        folder, shards, library = (Path(temporary) / name for name in ("meshes", "shards", "library.db"))
        folder.mkdir()
        make_meshes(folder, count)
        report = Path(temporary) / "report.csv"
        killed, resumed = [], []
        for number in range(1, SHARDS + 1):
            asked = ["compute", folder, "--out", shards, "--shard", f"{number}/{SHARDS}", *OPTIONS]
            killed.append(run(asked, report, kill_at=count // SHARDS // 2))
            resumed.append(run(asked, report))
        imports = [run(["import", shards, "--library", library], report) for _ in range(2)]
        with Library(str(library)) as opened:
            shapes = len(opened)
        sizes = [sum(path.stat().st_size for path in shards.iterdir()), library.stat().st_size]
        faults = find_faults(killed, resumed, imports, count, shapes)
        text = describe(killed, resumed, imports, sizes)
        write_section(PAGE, "shards", f"{text}\n\nFaults ({NO_FAULT}): {len(faults)}.")
    for fault in faults:
        print(fault, file=sys.stderr)
    sys.exit(int(bool(faults)))


if __name__ == "__main__":
    main()
