"""Error, time and memory on stretched meshes, with and without the intrinsic triangulation.

Measures good and stretched meshes. The comparison is the heat method of geometry-central, which also runs on an
intrinsic Delaunay triangulation. Errors are against exact distances. Takes a few minutes. Writes the section
"stretched" of docs/benchmarks/distances.md; --print only prints.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from benchmarks.common import BENCHMARKS, DATA, ROOT, in_turns, table, write_section
from benchmarks.geodesics.peers import potpourri_heat
from tests.support.oracles import exact_distances
from tests.support.stretched_meshes import cad_models, height_map
from unbend import Surface, read_mesh
from unbend.geodesics.distances import distance_rows
from unbend.geodesics.stencils import Stencils, build_stencils

SOURCES = 8
TIMED = 32
TIMED_VERTICES = 2000
"""Smaller meshes are not timed, because a row takes only microseconds."""

SLOPES = (1, 3, 10, 30, 100)
GIVEN, INTRINSIC, HEAT = "given triangles", "intrinsic triangulation", "potpourri3d heat"


@dataclass(frozen=True)
class Measured:
    """The numbers of one mesh: mean and largest relative error by method, and costs of the intrinsic triangulation."""

    errors: dict[str, tuple[float, float]]
    steiner: float
    """Steiner points per vertex."""
    row: float
    """Time of a row divided by the time on the given triangles; NaN if the mesh is not timed."""
    preparation: float
    memory: float
    """Bytes of the stencils divided by the bytes on the given triangles."""


def groups() -> Iterator[tuple[str, list[Surface]]]:
    """Yield the name and the meshes of each line of the table."""
    yield "eleven CAD models", list(cad_models().values())
    for slope in SLOPES:
        yield f"height map of slope {slope}", [height_map(slope)]
    case = ROOT / "tests" / "geodesics" / "cases" / "geo_steep_heightmap.obj"
    yield "height map of the cases", [read_mesh(case)]
    yield "lion", [read_mesh(DATA / "single" / "lion.off")]
    yield "cow", [read_mesh(DATA / "single" / "cow.off")]
    for name, folder, pattern, step in (
        ("30 of SHREC'11, 252 vertices", "shrec11_simplified", "*.obj", 16),
        ("TOSCA, 5 k", "tosca5k", "*.off", 1),
        ("FAUST, 5 k", "faust5k", "*.off", 1),
        ("8 of SHREC'07", "shrec07", "*.off", 16),
    ):
        yield name, [read_mesh(path) for path in sorted((DATA / folder).glob(pattern))[::step]]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--print", action="store_true", dest="only_print", help="leave the page alone")
    options = parser.parse_args()
    text = report({name: [measure(surface) for surface in surfaces] for name, surfaces in groups()})
    if options.only_print:
        print(text)
    else:
        write_section(BENCHMARKS / "distances.md", "stretched", text)


def measure(surface: Surface) -> Measured:
    used, faces = np.unique(surface.faces, return_inverse=True)  # peers drop vertices that no face uses, or crash
    surface = Surface(surface.vertices[used], faces.reshape(-1, 3))
    count = len(used)
    sources = np.unique(np.linspace(0, count - 1, SOURCES).astype(np.int32))
    exact = exact_distances(surface, sources)
    made = {name: build_stencils(surface, intrinsic=name == INTRINSIC) for name in (GIVEN, INTRINSIC)}
    errors = {
        name: error_of(distance_rows(found, sources, None, "spherical", 1), exact) for name, found in made.items()
    }
    errors[HEAT] = error_of(heat_rows(surface, sources), exact)
    row = preparation = float("nan")
    if count >= TIMED_VERTICES:
        timed = np.unique(np.linspace(0, count - 1, TIMED).astype(np.int32))
        rows = in_turns({name: lambda f=f: distance_rows(f, timed, None, "spherical", 1) for name, f in made.items()})
        built = in_turns({n: lambda n=n: build_stencils(surface, intrinsic=n == INTRINSIC) for n in made})
        row, preparation = rows[INTRINSIC][0] / rows[GIVEN][0], built[INTRINSIC][0] / built[GIVEN][0]
    memory = bytes_of(made[INTRINSIC]) / bytes_of(made[GIVEN])
    return Measured(errors, made[INTRINSIC].vertex_count / count - 1, row, preparation, memory)


def heat_rows(surface: Surface, sources: np.ndarray) -> np.ndarray | None:
    method = potpourri_heat()
    try:
        return method.rows(method.prepare((surface.vertices, surface.faces)), sources.tolist(), 1)
    except RuntimeError:  # potpourri3d refuses non-manifold meshes
        return None


def error_of(distances: np.ndarray | None, exact: np.ndarray) -> tuple[float, float]:
    if distances is None:
        return float("nan"), float("nan")
    known = exact > 0
    relative = 100 * np.abs(distances[known] / exact[known] - 1)
    return float(relative.mean()), float(relative.max())


def bytes_of(stencils: Stencils) -> int:
    return sum(array.nbytes for part in stencils.arrays for array in part)


def report(found: dict[str, list[Measured]]) -> str:
    errors, costs = [], []
    for name, meshes in found.items():
        columns = [np.array([mesh.errors[method] for mesh in meshes]) for method in (GIVEN, INTRINSIC, HEAT)]
        worst = columns[1].max(axis=0)
        errors.append([name, *map(shown, columns), f"{worst[0]:.2f} / {worst[1]:.1f}"])
        row, preparation, memory, steiner = (
            np.array([getattr(mesh, field) for mesh in meshes]) for field in ("row", "preparation", "memory", "steiner")
        )
        costs.append([name, f"{steiner.mean():.3f}", ratio(row), ratio(preparation), ratio(memory)])
    above = (
        f"**The intrinsic triangulation**: mean / largest relative error (%) of spherical marching over {SOURCES} "
        "sources against exact distances, averaged over the meshes of a row; the last column has the worst mesh. The "
        "heat method also runs on an intrinsic Delaunay triangulation."
    )
    below = (
        "The costs as ratios to those of the given triangles, measured in turns in one run and one thread; mean over "
        f"the meshes. Meshes of fewer than {TIMED_VERTICES:,} vertices are not timed."
    )
    first = table(["meshes", GIVEN, INTRINSIC, HEAT, "worst mesh, intrinsic"], errors)
    second = table(["meshes", "Steiner points per vertex", "time of a row", "preparation", "bytes of stencils"], costs)
    return f"{above}\n\n{first}\n\n{below}\n\n{second}"


def shown(errors: np.ndarray) -> str:
    known = errors[np.isfinite(errors[:, 0])]
    return f"{known[:, 0].mean():.2f} / {known[:, 1].mean():.1f}" if len(known) else "-"


def ratio(values: np.ndarray) -> str:
    known = values[np.isfinite(values)]
    return f"{known.mean():.2f}" if len(known) else "-"


if __name__ == "__main__":
    main()
