"""Retrieval metrics of every measure on real shapes and of published methods, and the effect of each parameter.

Queries are leave-one-out, and no measure is trained here. `benchmarks/retrieval/choice.py` chose the kernels, weights
and moments of some measures on half of the classes.
Takes a few minutes. Writes the section "retrieval" of docs/benchmarks/retrieval.md.
"""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from benchmarks.common import BENCHMARKS, table, write_section
from benchmarks.retrieval.data import DATASETS, half, in_processes, listed, signatures_of, unit_distances
from unbend import Signature, compute_signature, embed, read_mesh
from unbend.descriptors.distribution import distance_distribution
from unbend.descriptors.moments import moments
from unbend.descriptors.quadrature import surface_quadrature
from unbend.descriptors.spectrum import geodesic_spectrum
from unbend.matching.evaluate import RetrievalMetrics, evaluate
from unbend.matching.measures import DEFAULT_MEASURE, VECTOR_MEASURES, VectorMeasure, get_measure, get_vector_measure
from unbend.signature.parameters import Parameters

PUBLISHED = {
    "SD-GDM-meshSIFT, full resolution": ("1.000", "0.972", "0.990", "", "0.996", ""),
    "SD-GDM, full resolution": ("1.000", "0.962", "0.984", "", "0.994", ""),
    "MDS-CM-BOF, full resolution": ("0.995", "0.913", "0.969", "", "0.982", ""),
    "ShapeDNA, full resolution": ("0.992", "0.915", "0.957", "", "0.978", ""),
}
"""Metrics on SHREC'11's 600 meshes, from our notes of the literature; not checked against the track's report."""

PERSONS = ("tosca5k", "faust5k")
"""Data sets of persons, evaluated with each person as a class."""

FIGURES = ["NN", "FT", "ST", "E", "DCG", "mAP"]
EIGENVALUES = 20
DEFAULTS = Parameters()
ABLATION = {
    "defaults": DEFAULTS,
    "100 samples": replace(DEFAULTS, samples=100),
    "200 samples": replace(DEFAULTS, samples=200),
    "500 samples": replace(DEFAULTS, samples=500),
    "2 dimensions": replace(DEFAULTS, dimensions=2),
    "4 dimensions": replace(DEFAULTS, dimensions=4),
    "6 dimensions": replace(DEFAULTS, dimensions=6),
    "classical scaling": replace(DEFAULTS, method="classical"),
    "FastMap": replace(DEFAULTS, method="fast"),
    "planar update": replace(DEFAULTS, update="planar"),
}
ABLATED = ("spectrum", "combined", "moments", "distribution")


def main() -> None:
    signatures = {name: signatures_of(listed(name)[0], DEFAULTS) for name in DATASETS}
    parts = [
        "Leave-one-out over all shapes of a data set, default parameters.",
        table(["data set", "measure", *FIGURES], [row for name in DATASETS for row in _rows(name, signatures[name])]),
        (
            "Above, TOSCA's three persons are one class. Here each person of TOSCA and of FAUST is a class. All shapes"
            " of FAUST are persons in several poses:"
        ),
        table(["data set", "measure", *FIGURES], [row for name in PERSONS for row in _by_person(name)]),
        (
            "Published rows come from the SHREC'11 track of non-rigid shapes (Lian et al. 2011, \"SHREC'11 Track: Shape"
            ' Retrieval on Non-rigid 3D Watertight Meshes"), as our notes quote them; we have not checked them'
            " against its report."
        ),
        (
            "Queries only from the half of the classes that `benchmarks/retrieval/choice.py` did not use (every second "
            "class by name). Each query is compared with all other shapes:"
        ),
        table(["data set", "measure", *FIGURES], [_untouched(name, signatures[name]) for name in DATASETS]),
        f"Mean average precision after one change to the defaults, {' and '.join(DATASETS[:2])}.",
        table(["", *(f"{name} {of}" for name in DATASETS[:2] for of in ABLATED)], _ablation(signatures)),
    ]
    write_section(BENCHMARKS / "retrieval.md", "retrieval", "\n\n".join(parts))


def _rows(dataset: str, signatures: list[Signature]) -> list[list[str]]:
    paths, labels = listed(dataset)
    title = f"{dataset} ({len(labels)} in {len(set(labels))}{', persons merged' if dataset == 'tosca5k' else ''})"
    vectors = {name: _stacked(measure, signatures) for name, measure in VECTOR_MEASURES.items()}
    vectors["eigenvalues of classical scaling"] = np.stack(in_processes(_classical_eigenvalues, paths))
    rows = [[title, name, *_shown(_leave_one_out(_distances(of), labels))] for name, of in vectors.items()]
    rows.append([title, "reeb", *_shown(_leave_one_out(_reeb_matrix(signatures), labels))])
    if dataset == "shrec11_simplified":
        rows += [["SHREC'11 (600), published", name, *figures] for name, figures in PUBLISHED.items()]
    return rows


def _by_person(dataset: str) -> list[list[str]]:
    paths, labels = listed(dataset, merged=False)
    signatures = signatures_of(paths, DEFAULTS)
    title = f"{dataset} ({len(labels)} in {len(set(labels))})"
    return [
        [title, name, *_shown(_leave_one_out(measure.matrix(_stacked(measure, signatures)), labels))]
        for name, measure in VECTOR_MEASURES.items()
    ]


def _stacked(measure: VectorMeasure, signatures: list[Signature]) -> np.ndarray:
    return np.stack([measure.vector(of.descriptors) for of in signatures])


def _reeb_matrix(signatures: list[Signature]) -> np.ndarray:
    graphs = [SimpleNamespace(descriptors={"reeb": of.descriptors["reeb"]}) for of in signatures]
    upper = in_processes(_reeb_row, [(graphs[row], graphs[row + 1 :]) for row in range(len(graphs))])
    matrix = np.zeros((len(graphs), len(graphs)))
    for row, distances in enumerate(upper):
        matrix[row, row + 1 :] = matrix[row + 1 :, row] = distances
    return matrix


def _reeb_row(of: tuple[Any, list[Any]]) -> list[float]:
    return [get_measure("reeb").distance(of[0], other) for other in of[1]]


def _classical_eigenvalues(path: Path) -> np.ndarray:
    """Return the logarithms of the leading eigenvalues of classical scaling, the simplest spectral descriptor."""
    surface = read_mesh(path)
    distances = unit_distances(surface, compute_signature(surface, DEFAULTS, threads=1))
    found = embed(distances, EIGENVALUES, method="classical", threads=1).eigenvalues
    return np.log(np.maximum(found, 1e-9)).astype(np.float32)


def _untouched(dataset: str, signatures: list[Signature]) -> list[str]:
    labels = listed(dataset)[1]
    asked = half(labels, 1)
    measure = get_vector_measure(DEFAULT_MEASURE)
    distances = measure.matrix(_stacked(measure, signatures))
    # A unique label excludes a shape from the queries, but keeps the shape in the gallery of the others.
    names = [label if keep else f"{label} {row}" for row, (label, keep) in enumerate(zip(labels, asked, strict=True))]
    return [f"{dataset} ({asked.sum()} queries)", measure.name, *_shown(_leave_one_out(distances, names))]


def _ablation(signatures: dict[str, list[Signature]]) -> list[list[str]]:
    rows: dict[str, list[str]] = {name: [] for name in (*ABLATION, "equal weights of all samples")}
    for dataset in DATASETS[:2]:
        paths, labels = listed(dataset)
        for name, parameters in ABLATION.items():
            found = signatures[dataset] if parameters == DEFAULTS else signatures_of(paths, parameters)
            rows[name] += _precisions([of.descriptors for of in found], labels)
        rows["equal weights of all samples"] += _precisions(in_processes(_unweighted, paths), labels)
    return [[name, *figures] for name, figures in rows.items()]


def _precisions(described: list[dict[str, np.ndarray]], labels: list[str]) -> list[str]:
    figures = []
    for name in ABLATED:
        vectors = np.stack([get_vector_measure(name).vector(of) for of in described])
        figures.append(f"{_leave_one_out(_distances(vectors), labels).map:.3f}")
    return figures


def _unweighted(path: Path) -> dict[str, np.ndarray]:
    """Return descriptors in which every sample has the same weight."""
    surface = read_mesh(path)
    signature = compute_signature(surface, DEFAULTS, threads=1)
    distances = unit_distances(surface, signature)
    even = np.full(len(distances), 1 / len(distances))
    return {
        "spectrum": geodesic_spectrum(distances, even),
        "moments": moments(*surface_quadrature(signature.points, signature.faces, even)),
        "distribution": distance_distribution(distances, signature.points, even),
    }


def _distances(vectors: np.ndarray) -> np.ndarray:
    return get_vector_measure(DEFAULT_MEASURE).matrix(vectors)  # L1, like all vector measures


def _leave_one_out(distances: np.ndarray, labels: list[str]) -> RetrievalMetrics:
    return evaluate(distances, labels, labels, own=np.arange(len(labels))).metrics


def _shown(metrics: RetrievalMetrics) -> list[str]:
    return [f"{value:.3f}" for value in asdict(metrics).values()]


if __name__ == "__main__":
    main()
