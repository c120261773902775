"""Multidimensional scaling on many meshes: acceleration, order of methods, local minima, effective dimensions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from functools import partial

import numpy as np

from benchmarks.common import in_turns, table
from benchmarks.embedding.methods import SEARCHES, iterations_to
from unbend import effective_dimension, embed, farthest_point_sampling, geodesic_matrix
from unbend.embedding.checks import check_distances, scaled_to_range
from unbend.embedding.classical import classical_scaling
from unbend.embedding.fast import fastmap
from unbend.embedding.least_squares import smacof
from unbend.embedding.stress import stress
from unbend.mesh.shapes import cylinder, s_bend, sheet, spiral

LEFT = 1e-5
ABOVE = 0.005


def acceleration_table(matrices: dict[str, np.ndarray]) -> str:
    counts: dict[str, list[list[float]]] = {name: [] for name in SEARCHES}
    for distances in matrices.values():
        start = classical_scaling(distances, 3)[0]
        for name, made in iterations_to(distances, start, (1e-3, 1e-4, 1e-6)).items():
            counts[name].append(made)
    rows = []
    for name, made in counts.items():
        reached = np.isfinite(made)
        rows.append(
            [name, *(f"{np.median(column):.0f}" for column in np.transpose(made)), f"{reached[:, 2].mean():.0%}"]
        )
    return (
        f"**Acceleration**: median evaluations of B(X) X, over {len(matrices)} meshes, from classical scaling in three"
        " dimensions until the stress exceeds the least stress that any search reached on the mesh by at most the share"
        " of it that heads the column.\n\n"
        + table(["search", "1e-3", "1e-4", "1e-6", "share that reaches 1e-6 in 600"], rows)
    )


def order_table(matrices: dict[str, np.ndarray]) -> str:
    rises = Counter[str]()
    above = Counter[str]()
    for distances in matrices.values():
        before: dict[str, float] = {}
        for dimensions in range(1, 6):
            found = {
                method: embed(distances, dimensions, method=method, threads=1).stress
                for method in ("least_squares", "classical", "fast")
            }
            for method, value in found.items():
                rises[method] += value > before.get(method, np.inf) * (1 + LEFT)
                above[method] += found["least_squares"] > value * (1 + 1e-9)
            before = found
    rows = [[method, rises[method], above[method]] for method in ("least_squares", "classical", "fast")]
    return (
        f"**Order**: over {len(matrices)} meshes and m = 1 to 5, the number of cases in which a method's stress at m"
        f" exceeds its stress at m - 1 by more than {LEFT:.0e} of the latter (the search stops at 1e-6), and the number"
        " in which it is below the stress of least squares at the same m.\n\n"
        + table(["method", "rises with m", "below least squares"], rows)
    )


def minima_table(matrices: dict[str, np.ndarray]) -> str:
    """Return how often each start ends in a minimum above the lowest known stress."""
    lines = []
    for dimensions in (2, 3, 4):
        ways: dict[str, list[float]] = {"from classical scaling": [], "from low minima of a few points (ours)": []}
        seconds = [0.0, 0.0]
        for distances in matrices.values():
            runs: dict[str, Callable[[], float]] = {
                name: partial(way, distances, dimensions)
                for name, way in zip(ways, (_from_classical, _ours), strict=True)
            }
            found = in_turns(runs)
            lowest = min(embed(distances, dimensions, starts=10).stress, *(value for _, value in found.values()))
            for place, (name, (time, value)) in enumerate(found.items()):
                ways[name].append(value / lowest - 1)
                seconds[place] += time
        for (name, above), time in zip(ways.items(), seconds, strict=True):
            share = np.mean(np.array(above) > ABOVE)
            lines.append([dimensions, name, f"{share:.1%}", f"{max(above):.1%}", f"{time / seconds[0]:.2f}"])
    return (
        f"**Local minima**: for each m and start, the share of {len(matrices)} other meshes on which least squares ends"
        f" more than {ABOVE:.1%} above the lowest stress known (the least of both starts, and of ten random starts);"
        " the largest excess; and the time in one thread, divided by that of the first row of the same m. The first row"
        " of each m is the earlier method: it starts from classical scaling, and also from FastMap if the stress of"
        " FastMap itself is below the stress that least squares reached from classical scaling.\n\n"
        + table(["m", "start", "share above", "worst", "time / first row"], lines)
    )


def _from_classical(distances: np.ndarray, dimensions: int) -> float:
    distances, _ = scaled_to_range(check_distances(distances))  # as `embed` does
    start, _ = classical_scaling(distances, dimensions)
    lowest = stress(smacof(distances, start, threads=1)[0], distances)
    fast, _ = fastmap(distances, dimensions)
    if stress(fast, distances) < lowest:
        lowest = min(lowest, stress(smacof(distances, fast, threads=1)[0], distances))
    return lowest


def _ours(distances: np.ndarray, dimensions: int) -> float:
    return embed(distances, dimensions, threads=1).stress


def dimension_table(matrices: dict[str, np.ndarray]) -> str:
    sheets = Counter(
        effective_dimension(geodesic_matrix(surface, farthest_point_sampling(surface, 250)))
        for make in (sheet, cylinder, s_bend, spiral)
        for surface in [make(columns=48, rows=24)]
    )
    bodies = Counter(effective_dimension(distances) for distances in matrices.values())
    flat = [name for name, distances in matrices.items() if effective_dimension(distances) < 3]
    columns = sorted(sheets | bodies)
    rows = [[name, *(of[column] for column in columns)] for name, of in (("sheets", sheets), ("meshes", bodies))]
    return (
        "**Effective dimension**: the number of developable sheets and of meshes with each dimension. Meshes below 3: "
        + (", ".join(flat) or "none") + ".\n\n" + table(["dimension", *map(str, columns)], rows)
    )  # fmt: skip
