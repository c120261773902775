"""Studies of scaling over many meshes: acceleration, the order of the methods, effective dimensions."""

from __future__ import annotations

from collections import Counter

import numpy as np

from embedding_methods import SEARCHES, iterations_to
from peers import table
from unbend import effective_dimension, embed, farthest_point_sampling, geodesic_matrix
from unbend.embedding.classical import classical_scaling
from unbend.mesh.shapes import cylinder, s_bend, sheet, spiral

LEFT = 1e-5


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
        " dimensions until the stress is within a share of the least that any of these reached.\n\n"
        + table(["search", "1e-3", "1e-4", "1e-6", "reach 1e-6 in 600"], rows)
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
        f"**Order**: of {len(matrices)} meshes and m = 1 to 5, cases in which a method's stress rises with m by"
        f" more than {LEFT:.0e} of it (the search stops at 1e-6), and in"
        " which that of least squares is above it.\n\n" + table(["method", "rises with m", "below least squares"], rows)
    )


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
        "**Effective dimension**: how many of four developable sheets and of the meshes have which. Below 3 are: "
        + (", ".join(flat) or "none") + ".\n\n" + table(["dimension", *map(str, columns)], rows)
    )  # fmt: skip
