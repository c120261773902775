"""The real meshes that scaling is measured on, as matrices of distances between samples."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.common import DATA
from unbend import farthest_point_sampling, geodesic_matrix, read_mesh

SAMPLES = 300


def listed(dataset: str) -> list[Path]:
    with (DATA / "labels.csv").open(newline="") as file:
        return [DATA / row["path"] for row in csv.DictReader(file) if row["dataset"] == dataset]


def matrix_of(path: Path, samples: int) -> np.ndarray:
    surface = read_mesh(path)
    return geodesic_matrix(surface, farthest_point_sampling(surface, min(samples, len(surface.used_vertices))))


STEPS = {"shrec11_simplified": 20, "tosca5k": 8, "faust5k": 10, "shrec07": 10, "single": 1}
"""From each set, every n-th mesh is taken."""


def matrices_of_meshes() -> Iterator[tuple[str, np.ndarray]]:
    for dataset, step in STEPS.items():
        yield from _matrices(dataset, listed(dataset)[::step])


def matrices_of_others() -> Iterator[tuple[str, np.ndarray]]:
    """Yield matrices of meshes that `matrices_of_meshes` skips, and that were not used to choose constants."""
    for dataset, step in STEPS.items():
        if step > 1:
            yield from _matrices(dataset, listed(dataset)[step // 2 :: step])


def _matrices(dataset: str, paths: list[Path]) -> Iterator[tuple[str, np.ndarray]]:
    for path in paths:
        yield f"{dataset}/{path.stem}", matrix_of(path, SAMPLES)
