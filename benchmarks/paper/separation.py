"""Fig. 5: the separation of two classes over the number of dimensions, for least squares and classical scaling."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from benchmarks.common import table
from benchmarks.embedding.meshes import matrix_of
from benchmarks.paper.draw import Array, plt, save
from benchmarks.paper.meshes import listed
from unbend import embed, read_mesh
from unbend.matching.evaluate.separation import log_ratio

CLASSES = {"cat": "cat", "centaur": "centaur", "dog": "dog", "horse": "horse", "man": "michael"}  # TOSCA's names
MOST = 6  # members of a class
SAMPLES = 200
DIMENSIONS = range(1, 7)
LINES = {"least_squares": ("LS", "-", "black"), "classical": ("Classical", "--", "crimson")}
ALONE = (("cat", "dog"), ("cat", "man"))


def figure_5() -> str:
    matrices = {label: _matrices(name) for label, name in CLASSES.items()}
    ratios = {method: _ratios(matrices, method) for method in LINES}
    pairs = list(combinations(CLASSES, 2))
    shown = [*ALONE, f"median of {len(pairs)} pairs"]
    page, grid = plt.subplots(1, len(shown), figsize=(13, 4), layout="constrained")
    for axes, what in zip(grid, shown, strict=True):
        for method, (title, style, colour) in LINES.items():
            values = ratios[method][:, pairs.index(what)] if what in pairs else np.median(ratios[method], axis=1)
            axes.plot(DIMENSIONS, values, style, color=colour, label=title, marker="o", markersize=4)
        axes.set(title=" and ".join(what) if what in pairs else what, xlabel="m", xticks=DIMENSIONS)
        axes.grid(color="0.92")
    grid[0].set_ylabel("log ratio")
    grid[0].legend(frameon=False)
    save(page, "paper-fig5")
    return _table(ratios)


def _table(ratios: dict[str, Array]) -> str:
    wins = (ratios["least_squares"] > ratios["classical"]).sum(axis=1)
    medians = {title: np.median(ratios[method], axis=1) for method, (title, *_) in LINES.items()}
    rows = [[title, *(f"{value:.2f}" for value in values)] for title, values in medians.items()]
    rows.append([f"LS higher in, of {ratios['classical'].shape[1]}", *wins])
    return table(["median", *(f"m = {m}" for m in DIMENSIONS)], rows)


def _matrices(name: str) -> list[Array]:
    """Return the distance matrices of the members of a class, each scaled to area 1."""
    paths = listed("tosca5k", name)[:MOST]
    return [matrix_of(path, SAMPLES) / np.sqrt(read_mesh(path).area) for path in paths]


def _ratios(matrices: dict[str, list[Array]], method: str) -> Array:
    """Return the log ratio of every pair of classes, (dimensions, pairs)."""
    rows = []
    for m in DIMENSIONS:
        vectors = [np.stack([_moments(embed(d, m, method=method).points) for d in of]) for of in matrices.values()]
        rows.append([log_ratio(a, b) for a, b in combinations(vectors, 2)])
    return np.array(rows)


def _moments(points: Array) -> Array:
    """Return second and absolute third moments along each principal axis: at most 12 numbers (the paper: below 15)."""
    centred = points - points.mean(axis=0)
    posed = centred @ np.linalg.svd(centred, full_matrices=False)[2].T
    return np.concatenate([(posed**2).mean(axis=0), np.abs((posed**3).mean(axis=0))])
