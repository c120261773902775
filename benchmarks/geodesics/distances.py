"""Error, time and memory of geodesic distances, compared with every library that has a wheel.

Each method runs in a process of its own, and the methods take turns on a mesh. Writes the section "geodesics" of
docs/benchmarks/distances.md and docs/pictures/geodesics.png; with --quick, measures less and only prints.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path

from benchmarks.common import BENCHMARKS, ROOT, write_section
from benchmarks.geodesics.figure import draw
from benchmarks.geodesics.measure import measure
from benchmarks.geodesics.meshes import DETAILED, REAL, Folder, Mesh
from benchmarks.geodesics.peers import PACKAGES
from benchmarks.geodesics.studies import coarse_table, scaling_table, sheared_table, sphere_table
from benchmarks.geodesics.tables import Results, cost_table, error_table, time_table

PICTURE = ROOT / "docs" / "pictures" / "geodesics.png"


def main(arguments: list[str]) -> None:
    quick = "--quick" in arguments
    with tempfile.TemporaryDirectory() as path:
        folder = Folder(Path(path))
        results = _measure_meshes(folder, quick=quick)
        detailed = {name: of for name, of in results.items() if name in DETAILED}
        parts = [_circumstances(), error_table(results), time_table(results)]
        parts += [f"![Error over time](../pictures/{PICTURE.name})", cost_table(detailed)]
        parts += _study(folder, quick=quick)
    text = "\n\n".join(parts)
    if quick:
        print(text)
    else:
        draw(detailed, PICTURE)
        write_section(BENCHMARKS / "distances.md", "geodesics", text)


def _measure_meshes(folder: Folder, *, quick: bool) -> Results:
    meshes = [folder.real(name) for name in (DETAILED[:1] if quick else REAL)]
    meshes.append(folder.torus(40, 25) if quick else folder.torus(160, 100))
    small = folder.sphere(2)
    results: Results = {}
    for mesh in meshes:
        _log_step(mesh.name)
        results[mesh.name] = measure(mesh, small, rounds=1 if quick else 8, matrices=mesh.name in DETAILED)
    return results


def _study(folder: Folder, *, quick: bool) -> Iterator[str]:
    _log_step("coarse meshes")
    yield coarse_table(folder)
    _log_step("sheared grid")
    yield sheared_table(folder, [20, 40] if quick else [80, 160, 320])
    _log_step("sphere")
    yield sphere_table(folder, range(3, 5 if quick else 8))
    _log_step("scaling")
    yield scaling_table(_growing_meshes(folder, quick=quick), folder.sphere(2))


def _growing_meshes(folder: Folder, *, quick: bool) -> Iterator[Mesh]:
    for columns, rows in [(210, 133)] if quick else [(210, 133), (400, 250), (800, 400), (1250, 800)]:
        yield folder.torus(columns, rows)
    bunny = folder.real("fine bunny (29.8 k)")
    for times in range(1 if quick else 4):
        yield folder.subdivided(bunny, times)


def _circumstances() -> str:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    versions = ", ".join(f"{package} {version(package)}" for package in PACKAGES)
    return (
        f"Geodesic distances from one vertex to all others, measured in one run on {cores} cores. Every method has its"
        " own process, and the methods take turns. The time of a turn is that of its median row; the quickest turn"
        " counts."
        f" Versions: {versions}."
    )


def _log_step(step: str) -> None:
    print(f"{time.strftime('%H:%M:%S')} {step}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
