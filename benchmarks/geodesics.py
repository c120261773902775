"""Error and time of geodesic distances, against exact ones and against peers, in one run on the same meshes.

Errors are means over sources of |d - exact| / exact, in percent; times are a source's, on one core, without what
each method prepares once for a mesh. Writes the section "geodesics" of docs/benchmarks.md.
"""

from __future__ import annotations

import numpy as np
import potpourri3d
import pygeodesic.geodesic as exact_geodesics

from peers import DATA, ROOT, best_of, table, write_section
from unbend import Surface, read_mesh
from unbend.geodesics.distances import distance_rows
from unbend.geodesics.stencils import build_stencils
from unbend.mesh.shapes import torus

MESHES = {
    "FAUST (5 k)": "faust5k/tr_reg_000.off",
    "cat (5 k)": "tosca5k/cat0.off",
    "centaur (5 k)": "tosca5k/centaur0.off",
    "human (6.9 k)": "single/human_man.obj",
    "bunny (3.3 k)": "single/bunny.obj",
    "armadillo (14.6 k)": "single/armadillo.obj",
}
SOURCES = 4


def main() -> None:
    surfaces = {name: read_mesh(DATA / path) for name, path in MESHES.items()}
    surfaces["torus grid (16 k)"] = torus(columns=160, rows=100)
    rows = [_row(name, surface) for name, surface in surfaces.items()]
    header = ["mesh", "planar", "spherical", "potpourri3d FMM", "potpourri3d heat", "ns a vertex, spherical"]
    header += ["times faster than FMM", "than heat", "than exact"]
    coarse = _coarse_errors()
    text = (
        f"Mean relative error (%) over {SOURCES} sources, and time a source on one core.\n\n"
        + table(header, rows)
        + "\n\nMean over 30 SHREC'11 meshes of 252 vertices, every vertex a source:"
        + f" planar {coarse[0]:.2f} %, spherical {coarse[1]:.2f} %;"
        + f" with the smaller of both directions, as in the matrix: {coarse[2]:.2f} % and {coarse[3]:.2f} %."
    )
    write_section(ROOT / "docs" / "benchmarks.md", "geodesics", text)


def _row(name: str, surface: Surface) -> list[str]:
    sources = np.linspace(0, len(surface.vertices) - 1, SOURCES).astype(np.int32)
    stencils = build_stencils(surface)
    algorithm = exact_geodesics.PyGeodesicAlgorithmExact(surface.vertices, surface.faces)
    exact = np.array([algorithm.geodesicDistances(np.array([source]))[0] for source in sources])
    marching = potpourri3d.MeshFastMarchingDistanceSolver(surface.vertices, surface.faces)
    heat = potpourri3d.MeshHeatMethodDistanceSolver(surface.vertices, surface.faces)
    errors = [
        _error(distance_rows(stencils, sources, None, "planar", 1), exact),
        _error(distance_rows(stencils, sources, None, "spherical", 1), exact),
        _error(np.array([marching.compute_distance([[(int(source), [])]]) for source in sources]), exact),
        _error(np.array([heat.compute_distance(int(source)) for source in sources]), exact),
    ]
    own = best_of(5, lambda: distance_rows(stencils, sources, None, "spherical", 1)) / SOURCES
    peers = [
        best_of(5, lambda: marching.compute_distance([[(0, [])]])),
        best_of(5, lambda: heat.compute_distance(0)),
        best_of(2, lambda: algorithm.geodesicDistances(np.array([0]))),
    ]
    return [
        name, *(f"{error:.2f}" for error in errors), f"{own / len(surface.vertices) * 1e9:.0f}",
        *(f"{peer / own:.1f}" for peer in peers),
    ]  # fmt: skip


def _coarse_errors() -> list[float]:
    errors = []
    for path in sorted((DATA / "shrec11_simplified").glob("*.obj"))[::16]:
        surface = read_mesh(path)
        sources = np.arange(len(surface.vertices), dtype=np.int32)
        algorithm = exact_geodesics.PyGeodesicAlgorithmExact(surface.vertices, surface.faces)
        exact = np.array([algorithm.geodesicDistances(np.array([source]))[0] for source in sources])
        stencils = build_stencils(surface)
        planar, spherical = (distance_rows(stencils, sources, None, update, 2) for update in ("planar", "spherical"))
        both = [planar, spherical, np.minimum(planar, planar.T), np.minimum(spherical, spherical.T)]
        errors.append([_error(distances, exact) for distances in both])
    return np.mean(errors, axis=0).tolist()


def _error(distances: np.ndarray, exact: np.ndarray) -> float:
    known = (exact > 0) & np.isfinite(exact)
    return float(100 * (np.abs(distances - exact)[known] / exact[known]).mean())


if __name__ == "__main__":
    main()
