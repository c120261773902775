"""A library is moved from SQLite to PostgreSQL and back: seconds, rows a second, and memory.

    python -m benchmarks.cluster.moving

Makes a library of 2000 shapes from those of `unbend demo`, once also with a file of 64 MB. Starts a PostgreSQL server
in the folder for temporary files, and runs `unbend migrate-library` as a process. Writes the section "moving" of
docs/benchmarks/cluster.md, in about ten minutes. Each figure is that of the quickest of three runs.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from sqlalchemy import func, select

from benchmarks.common import BENCHMARKS, table, write_section
from tests.support.postgres import Postgres, running_postgres
from unbend import Library
from unbend.cli.main import main as unbend
from unbend.library import shape_rows
from unbend.library.packing import PackedSignature
from unbend.library.requests import ShapeRequest, Upload
from unbend.library.shape_rows import ComputedShape
from unbend.library.storage.schema import local_signatures, meshes

SHAPES = 2000
LARGE = 64 * 2**20
TOGETHER = 50
TURNS = 3
MEASURED = """
import re, sys
from unbend.cli import main
main(["migrate-library", *sys.argv[1:], "--json", "--quiet"], standalone_mode=False)
print(re.search(r"VmHWM:\\s+(\\d+)", open("/proc/self/status").read())[1])
"""


@dataclass(frozen=True)
class Run:
    """One run of the command."""

    seconds: float
    rows: int
    peak: int
    """Most memory that the process had, in bytes."""


def fill(path: Path) -> None:
    """Store 2000 shapes: those of the demo, again and again, with different files."""
    unbend(["demo", "--library", str(path), "--quiet"], standalone_mode=False)
    with Library(str(path)) as library:
        demo = [(shape, library.mesh(shape.id), packed(library, shape.id)) for shape in library]
        for first in range(len(demo), SHAPES, TOGETHER):
            with library.store.write() as connection:
                for number in range(first, min(first + TOGETHER, SHAPES)):
                    shape, data, signature = demo[number % len(demo)]
                    upload = Upload(data + b"\n" * (number // len(demo)), shape.file_type, shape.parameters)
                    shape_rows.put_mesh(connection, upload.key.sha256, upload.data)
                    computed = ComputedShape(upload.key, signature, shape.area, shape.report)
                    request = ShapeRequest(f"{shape.name} {number}", shape.label, {"number": number})
                    shape_rows.add_shape(connection, computed, request)


def packed(library: Library, shape_id: str) -> PackedSignature:
    """Return what the library stores of a signature."""
    with library.store.read() as connection:
        wanted = (
            select(local_signatures.c.payload)
            .join(shape_rows.shapes, shape_rows.shapes.c.signature_id == local_signatures.c.signature_id)
            .where(shape_rows.shapes.c.id == shape_id)
        )
        local = connection.scalar(wanted)
    return replace(PackedSignature.of(library.signature(shape_id)), local=local)


def add_large(path: Path) -> None:
    """Store a file of 64 MB."""
    data = os.urandom(LARGE)
    with Library(str(path)) as library, library.store.write() as connection:
        shape_rows.put_mesh(connection, Upload(data, "ply").key.sha256, data)


def run(source: str, target: str) -> Run:
    """Run the command in a process of its own, which then prints its largest size."""
    done = subprocess.run(
        [sys.executable, "-c", MEASURED, source, target], capture_output=True, text=True, check=True
    ).stdout.splitlines()
    found = json.loads(done[0])
    return Run(found["seconds"], sum(found["rows"].values()), int(done[1]) * 1024)


def size_of(path: Path) -> tuple[int, int]:
    """Return the bytes of a library, and of its files."""
    with Library(str(path)) as library, library.store.read() as connection:
        return path.stat().st_size, connection.scalar(select(func.sum(meshes.c.size))) or 0


def measure(postgres: Postgres, path: Path, suffix: str) -> list[list[str]]:
    """Move a library in each direction, in turns; return rows of the table."""
    best: dict[str, Run] = {}
    for _ in range(TURNS):
        url, back, again = postgres.new(), path.with_name("back.db"), path.with_name("again.db")
        for label, source, target in (
            ("SQLite to PostgreSQL", path, url),
            ("PostgreSQL to SQLite", url, back),
            ("SQLite to SQLite", path, again),
            ("SQLite to PostgreSQL, run again when complete", path, url),
        ):
            done = run(str(source), str(target))
            if label not in best or done.seconds < best[label].seconds:
                best[label] = done
        back.unlink()
        again.unlink()
        postgres.drop(url)
    return [
        [label + suffix, f"{done.seconds:.1f}", f"{done.rows / done.seconds:,.0f}", f"{done.peak / 2**20:.0f}"]
        for label, done in best.items()
    ]


def main() -> None:
    """Measure, and write the section."""
    with TemporaryDirectory() as folder, running_postgres() as postgres:
        path = Path(folder, "library.db")
        fill(path)
        size, files = size_of(path)
        rows = measure(postgres, path, "")
        add_large(path)
        rows += measure(postgres, path, ", with a file of 64 MB")
    text = (
        f"A library of {SHAPES} shapes, made from those of `unbend demo`: {size / 2**20:.0f} MB, of which"
        f" {files / 2**20:.0f} MB are files. The database and the command share two cores, with other programs:"
        f" the load was {os.getloadavg()[2]:.0f}. Times include the check of the source and the comparison of each row."
        f" Memory is the most that the process had. Number of runs, of which the quickest counts: {TURNS}.\n\n"
    )
    text += table(["", "seconds", "rows a second", "memory, MB"], rows)
    write_section(BENCHMARKS / "cluster.md", "moving", text)


if __name__ == "__main__":
    main()
