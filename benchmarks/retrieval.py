"""Retrieval figures of every measure on the real data sets: the paper's Fig. 8 in numbers.

Leave-one-out, default parameters, nothing learned and nothing tuned. Writes "retrieval" of docs/benchmarks.md.
"""

from __future__ import annotations

import csv
from dataclasses import asdict

import numpy as np

from peers import DATA, ROOT, table, write_section
from unbend.errors import UnbendError
from unbend.jobs.batch import compute_paths
from unbend.matching.evaluate import leave_one_out
from unbend.matching.measures import VECTOR_MEASURES
from unbend.signature.parameters import Parameters

HUMANS = {"david", "michael", "victoria"}
"""Persons of TOSCA, who are one class."""


def main() -> None:
    rows = [row for name in ("shrec11_simplified", "tosca5k", "shrec07") for row in _rows(name)]
    header = ["data set", "measure", "NN", "FT", "ST", "E", "DCG", "mAP"]
    write_section(ROOT / "docs" / "benchmarks.md", "retrieval", table(header, rows))


def _rows(dataset: str) -> list[list[str]]:
    with (DATA / "labels.csv").open(newline="") as file:
        listed = [row for row in csv.DictReader(file) if row["dataset"] == dataset]
    labels = ["human" if row["class"] in HUMANS else row["class"] for row in listed]
    signatures = []
    for outcome in compute_paths([DATA / row["path"] for row in listed], Parameters()):
        if isinstance(outcome, UnbendError):
            raise outcome
        signatures.append(outcome)
    rows = []
    for measure in VECTOR_MEASURES.values():
        vectors = np.stack([measure.vector(signature.descriptors) for signature in signatures])
        figures = asdict(leave_one_out(measure.matrix(vectors), labels))
        rows.append([f"{dataset} ({len(listed)})", measure.name, *(f"{value:.3f}" for value in figures.values())])
    return rows


if __name__ == "__main__":
    main()
