"""Tables of the measurements on single meshes: error, time, preparation, matrix and memory."""

from __future__ import annotations

from benchmarks.common import table
from benchmarks.geodesics.measure import ERROR_SOURCES, MATRIX_SIZE, TIMED_SOURCES, Error, Result
from benchmarks.geodesics.peers import APPROXIMATE, EXACTS, METHODS, OURS, PEERS, PLANAR, SLOW_EXACT, SPHERICAL
from benchmarks.geodesics.session import Opened, Timing

Results = dict[str, dict[str, Result]]
"""By mesh, then by method."""
_THREADED = 1.3  # processor time over wall time


def error_table(results: Results) -> str:
    rows = [[mesh, *(_error_cell(of[name].error) for name in APPROXIMATE)] for mesh, of in results.items()]
    differences = [of[SLOW_EXACT].error for of in results.values()]
    furthest = max((error[1] for error in differences if not isinstance(error, str)), default=0.0)
    return (
        f"**Error**: mean / largest relative error (%) over {ERROR_SOURCES} sources and all vertices, against the exact"
        f" distances of pygeodesic (libigl's exact ones differ from these by at most {furthest:.1g} %).\n\n"
        + table(["mesh", *APPROXIMATE], rows)
    )


def time_table(results: Results) -> str:
    header = ["mesh", PLANAR, SPHERICAL, "spherical, one per call", "spherical, all threads", *PEERS]
    return (
        "**Time a source** (ms) after preparation, in one thread unless the column says otherwise. Ours:"
        f" {TIMED_SOURCES} sources in one call, or one a call; peers take one a call. In brackets: the ratio to the"
        f" time of {SPHERICAL} (third column). Methods that take over half a second are measured once.\n\n"
        + table(header, [_time_row(mesh, of) for mesh, of in results.items()])
    )


def _time_row(mesh: str, of: dict[str, Result]) -> list[str]:
    own = of[SPHERICAL]
    cells = [milliseconds(timing) for timing in (of[PLANAR].many, own.many, own.alone, own.all_threads)]
    for name in PEERS:
        timing = of[name].alone
        known = isinstance(timing, Timing) and isinstance(own.many, Timing)
        cells.append(milliseconds(timing) + (f" ({_ratio(timing.seconds / own.many.seconds)})" if known else ""))
    return [mesh, *cells]


def cost_table(results: Results) -> str:
    kinds = ("preparation, ms", "matrix, s", "bytes per vertex")
    header = ["method", *(f"{mesh.split(' (')[0]}: {kind}" for mesh in results for kind in kinds)]
    rows = []
    for name in METHODS:
        rows.append([name, *(cell for of in results.values() for cell in _cost_cells(name, of[name]))])
        if name in OURS:
            every = [seconds(of[name].matrix_all_threads) for of in results.values()]
            rows.append([f"{name}, all threads", *(cell for time in every for cell in ("", time, ""))])
    return (
        "**Preparation, matrix, memory**: time before the first source (stencils, factorisation, mesh structures);"
        f" time of the symmetric {MATRIX_SIZE} x {MATRIX_SIZE} matrix between farthest point samples, without the"
        " preparation (~: exact methods, one row's time times the number of rows); peak memory of preparing and"
        " computing the distances from one source, beyond libraries and mesh. Peers run with their default settings;"
        f" those that used more than one core: {_threaded_peers(results)}.\n\n" + table(header, rows)
    )


def _cost_cells(name: str, result: Result) -> tuple[str, str, str]:
    guessed = "~ " if name in EXACTS and isinstance(result.matrix, Timing) else ""
    opened = result.opened
    memory = opened if isinstance(opened, str) else f"{opened.peak_bytes / opened.vertices:.0f}"
    return milliseconds(result.preparation), guessed + seconds(result.matrix), memory


def _threaded_peers(results: Results) -> str:
    threaded = []
    for name in PEERS:
        opened = [of[name].opened for of in results.values()]
        known = [one for one in opened if isinstance(one, Opened)]
        for doing in ("preparation", "row"):
            cores = max((getattr(one, doing).cores for one in known), default=0.0)
            if cores > _THREADED:
                threaded.append(f"{name}, {doing} ({cores:.1f})")
    return "; ".join(threaded) or "none"


def milliseconds(time: Timing | float | str) -> str:
    if isinstance(time, str):
        return time
    return _three_digits(1e3 * (time.seconds if isinstance(time, Timing) else time))


def seconds(timing: Timing | str) -> str:
    return timing if isinstance(timing, str) else _three_digits(timing.seconds)


def _error_cell(error: Error | str) -> str:
    return error if isinstance(error, str) else f"{error[0]:.2f} / {error[1]:.0f}"


def _ratio(value: float) -> str:
    return f"{value:.0f}" if value >= 10 else f"{value:.1f}"


def _three_digits(value: float) -> str:
    return f"{value:.0f}" if value >= 100 else f"{value:.3g}"
