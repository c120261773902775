"""Tables of series of meshes: many coarse ones, refinements with known distances, and sizes up to millions."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack

import numpy as np

from benchmarks.common import table
from benchmarks.geodesics.measure import Error, error_of, start_workers
from benchmarks.geodesics.meshes import SHEAR, Folder, Mesh, great_circles, straight_lines
from benchmarks.geodesics.peers import APPROXIMATE, EXACT, SPHERICAL, Array
from benchmarks.geodesics.worker import PeerFailedError, Worker

SOURCES = 4
_LARGEST_EXACT = 20_000  # vertices; on larger meshes exact geodesics take seconds for each source


def coarse_table(folder: Folder) -> str:
    meshes = folder.coarse()
    errors: dict[str, list[tuple[float, ...] | str]] = {name: [] for name in APPROXIMATE}
    with ExitStack() as stack:
        workers = start_workers(stack, [*APPROXIMATE, EXACT], meshes[0].path)
        for mesh in meshes:
            exact = _rows(workers[EXACT], mesh, range(mesh.count))
            for name in APPROXIMATE:
                errors[name].append(_coarse_errors(_rows(workers[name], mesh, range(mesh.count)), exact))
    header = ["method", "mean", "largest", "mean, the smaller of both directions"]
    return (
        f"**Coarse meshes**: relative error (%) on {len(meshes)} SHREC'11 meshes of {meshes[0].count} vertices, every"
        " vertex a source, averaged over the meshes. The last column, like our matrices, takes the smaller of the"
        " distances from i to j and from j to i.\n\n"
        + table(header, [_coarse_row(name, of) for name, of in errors.items()])
    )


def _coarse_errors(distances: Array | str, exact: Array | str) -> tuple[float, ...] | str:
    one_way = error_of(distances, exact)
    if isinstance(one_way, str):
        return one_way
    return *one_way, error_of(np.minimum(distances, distances.T), exact)[0]


def _coarse_row(name: str, errors: Sequence[tuple[float, ...] | str]) -> list[str]:
    failures = [error for error in errors if isinstance(error, str)]
    if failures:
        return [name, f"{len(failures)} meshes: {failures[0]}", "-", "-"]
    mean, largest, both = np.mean(errors, axis=0)
    return [name, f"{mean:.2f}", f"{largest:.0f}", f"{both:.2f}"]


def sheared_table(folder: Folder, sizes: Iterable[int]) -> str:
    meshes = [folder.sheared(size) for size in sizes]
    errors = _errors_on(meshes, APPROXIMATE, lambda mesh: [mesh.count // 2], straight_lines)
    rows = [[name, *(_cell(error) for error in of)] for name, of in errors.items()]
    return (
        "**Sheared grid**: mean relative error (%) of distances from the centre of a flat square grid sheared by"
        f" {SHEAR} (angles of 12, 22 and 146 degrees), under refinement. Geodesics there are straight lines.\n\n"
        + table(["method", *(mesh.name for mesh in meshes)], rows)
    )


def sphere_table(folder: Folder, subdivisions: Sequence[int]) -> str:
    meshes = [folder.sphere(number) for number in subdivisions]
    errors = _errors_on(meshes, [*APPROXIMATE, EXACT], lambda mesh: mesh.spread(SOURCES), great_circles)
    rows = [[name, *(_cell(error) for error in of), _order(of)] for name, of in errors.items()]
    return (
        "**Sphere**: mean relative error (%) against great circles on icospheres, by number of vertices, and the order"
        " of convergence fitted to it (error ~ edge length ^ order). Exact polyhedral distances show the error of the"
        " mesh itself.\n\n" + table(["method", *(mesh.name for mesh in meshes), "order"], rows)
    )


def _order(errors: Sequence[Error | str]) -> str:
    known = [(level, error[0]) for level, error in enumerate(errors) if not isinstance(error, str)]
    if len(known) < 2:
        return "-"
    levels, means = np.transpose(known)
    return f"{-np.polyfit(levels, np.log2(means), 1)[0]:.2f}"


def _errors_on(
    meshes: Sequence[Mesh],
    names: Sequence[str],
    choose: Callable[[Mesh], list[int]],
    truth: Callable[[Mesh, list[int]], Array],
) -> dict[str, list[Error | str]]:
    errors: dict[str, list[Error | str]] = {name: [] for name in names}
    with ExitStack() as stack:
        workers = start_workers(stack, list(names), meshes[0].path)
        for mesh in meshes:
            sources = choose(mesh)
            known = truth(mesh, sources)
            for name in names:
                skipped = name == EXACT and mesh.count > _LARGEST_EXACT
                errors[name].append(error_of("-" if skipped else _rows(workers[name], mesh, sources), known))
    return errors


def scaling_table(meshes: Iterable[Mesh], small: Mesh) -> str:
    header = ["mesh", "preparation", "one source per call", "8 sources per call", "8 sources per call, all threads"]
    header += ["peak bytes", "peak bytes with the surface"]
    return (
        f"**Scaling** of {SPHERICAL}, per vertex: nanoseconds of preparation (stencils) and of a source, in one thread"
        " unless the column says otherwise, and the peak memory of a first `geodesic_distances` with one source, which"
        " builds the stencils. The first of the two columns of memory excludes the libraries and the surface, the"
        " second only the libraries.\n\n"
        + table(header, [[mesh.name, *_scaling_cells(mesh, small)] for mesh in meshes])
    )


def _scaling_cells(mesh: Mesh, small: Mesh) -> list[str]:
    with Worker(SPHERICAL, small.path) as worker:
        try:
            opened = worker.call("open", str(mesh.path))
            alone = worker.call("time_alone", mesh.spread(3), 5.0).seconds
            many = [worker.call("time_many", mesh.spread(8), threads).seconds for threads in (1, None)]
        except PeerFailedError as failure:
            return [str(failure), *"-----"]
    times = [max(0.0, opened.preparation.seconds - alone), alone, *many]
    memory = [opened.peak_bytes, opened.peak_bytes + opened.mesh_bytes]
    return [f"{value / mesh.count:.0f}" for value in (*(1e9 * time for time in times), *memory)]


def _rows(worker: Worker, mesh: Mesh, sources: Iterable[int]) -> Array | str:
    try:
        worker.call("open", str(mesh.path))
        return worker.call("rows", list(sources))
    except PeerFailedError as failure:
        return str(failure)


def _cell(error: Error | str) -> str:
    if isinstance(error, str):
        return error
    return "< 0.001" if error[0] < 0.001 else f"{error[0]:.3g}"
