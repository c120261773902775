"""Retrieval of disturbed shapes: remeshed, cut, scaled, noisy; and the detection of noise.

Uses the default parameters and measure, and takes about eight minutes on two cores. Writes the section "robustness" of
docs/benchmarks/robustness.md; `--quick` runs few queries, and only prints.
"""

from __future__ import annotations

import argparse
import csv
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.common import BENCHMARKS, DATA, table, write_section
from benchmarks.retrieval.data import in_processes, listed
from benchmarks.retrieval.robustness_changes import DISTURBANCES, NOISE, NOTHING, described, roughnesses
from unbend.arrays import Floats, Singles
from unbend.matching.measures import DEFAULT_MEASURE, get_vector_measure
from unbend.mesh.roughness import ROUGH

EVERY = {"tosca5k": 1, "shrec07": 4, "shrec11_simplified": 8}
"""Every n-th mesh of a data set is a query, in the order of labels.csv. The gallery has all meshes."""

QUICK = 24
"""With `--quick`, only every n-th mesh is used, and the queries are chosen from these."""

POSE = "another pose (undisturbed query, its own mesh left out)"

INTRODUCTION = f"""\
Each cell has two rates: how often the nearest shape to a disturbed query is the query's own original,
and how often it is of the query's class, by `{DEFAULT_MEASURE}`. In brackets in the header: the number
of queries, and of all shapes. Only the query is disturbed and smoothed. The members of a class of
tosca5k and shrec11_simplified are poses of one object (the humans of tosca5k are three people), so a
measure that is invariant to bending cannot prefer the original. The members of a class of shrec07 are
different objects. Noise is Gaussian in each coordinate; its standard deviation is a share of the
bounding box's diagonal. A hole is a geodesic disc."""

REASONS = """\
Reasons for rates below .95. If the class is correct but the original is not the nearest, another pose of
the same object is nearer to the disturbed query than the original is; for this measure, the original and
the other pose are one surface. *Another pose* of shrec07 is another object. *Noise* is not bending:
noise as large as the triangles (1 % of the diagonal on meshes of thousands of vertices) enlarges the
area out of proportion to the distances. The report of such a mesh says that it is rough. *Smoothing*
removes features that are only a few triangles wide: 30 rounds remove noise from thousands of vertices,
but limbs from the 250 vertices of shrec11_simplified, where one round is better. *Holes* of 1 % of the
faces are as wide as such limbs, and make the paths around them longer."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="A few queries, only printed.")
    quick = parser.parse_args().quick
    start = time.perf_counter()
    text = _text(QUICK if quick else 1)
    if quick:
        print(text)
    else:
        write_section(BENCHMARKS / "robustness.md", "robustness", text)
    print(f"{time.perf_counter() - start:.0f} s")


def _text(step: int) -> str:
    columns = {dataset: _rates(dataset, step) for dataset in EVERY}
    header = ["disturbance", *(f"{dataset} ({count} of {size})" for dataset, (count, size, _) in columns.items())]
    names = [POSE, *(name for name in DISTURBANCES if name != NOTHING)]
    rows = [[name, *(rates[name] for _, _, rates in columns.values())] for name in names]
    heading = f"Meshes reported as rough (roughness above {ROUGH}), and the range of roughness:"
    return "\n\n".join([INTRODUCTION, table(header, rows), REASONS, heading, _roughness_table(step)])


def _rates(dataset: str, step: int) -> tuple[int, int, dict[str, str]]:
    """Return the number of queries, the number of shapes, and the rates of each disturbance."""
    paths, labels = (found[::step] for found in listed(dataset))
    asked = range(0, len(paths), EVERY[dataset])
    jobs = [(NOTHING, path) for path in paths]
    jobs += [(name, paths[row]) for name in DISTURBANCES if name != NOTHING for row in asked]
    vectors = dict(zip(jobs, _vectors(jobs), strict=True))
    gallery, names = np.stack([vectors[NOTHING, path] for path in paths]), np.array(labels)
    measure = get_vector_measure(DEFAULT_MEASURE)

    def distances(name: str) -> Floats:
        return np.stack([measure.distances(vectors[name, paths[row]], gallery) for row in asked])

    def rate(name: str) -> str:
        nearest = distances(name).argmin(axis=1)
        return f"{np.mean(nearest == asked):.3f} / {np.mean(names[nearest] == names[asked]):.3f}"

    poses = distances(NOTHING)
    poses[np.arange(len(asked)), asked] = np.inf
    rates = {POSE: f"- / {np.mean(names[poses.argmin(axis=1)] == names[asked]):.3f}"}
    rates |= {name: rate(name) for name in DISTURBANCES if name != NOTHING}
    return len(asked), len(paths), rates


def _vectors(jobs: Sequence[tuple[str, Path]]) -> list[Singles]:
    """Return the vectors of the default measure, computed in processes that start with the largest files."""
    order = sorted(range(len(jobs)), key=lambda job: -jobs[job][1].stat().st_size)
    measure, found = get_vector_measure(DEFAULT_MEASURE), dict[int, Singles]()
    for job, descriptors in zip(order, in_processes(described, [jobs[job] for job in order]), strict=True):
        found[job] = measure.vector(descriptors)
    return [found[job] for job in range(len(jobs))]


def _roughness_table(step: int) -> str:
    with (DATA / "labels.csv").open(newline="") as file:
        listed_rows = list(csv.DictReader(file))[::step]
    found = in_processes(roughnesses, [DATA / row["path"] for row in listed_rows])
    datasets = list(dict.fromkeys(row["dataset"] for row in listed_rows))
    rows = []
    for place, noise in enumerate(NOISE):
        cells = [noise]
        for dataset in datasets:
            of = [pair for pair in zip(found, listed_rows, strict=True) if pair[1]["dataset"] == dataset]
            values = np.array([values[place] for values, _ in of if values])
            cells.append(f"{(values > ROUGH).sum()} of {len(values)}: {values.min():.4f} to {values.max():.4f}")
        rows.append(cells)
    return table(["noise", *datasets], rows)


if __name__ == "__main__":
    main()
