"""Chooses the kernels of `spectrum`, the weights of `combined` and the moments of `moments`, on half of the classes.

Every second class of each data set, in alphabetical order, is in the half that chooses. The criterion is the mean over
data sets of the mean average precision. Galleries always contain all shapes. Writes the section "retrieval-choice" of
docs/benchmarks/retrieval.md.
"""

from __future__ import annotations

from functools import cache
from itertools import combinations, combinations_with_replacement, product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.common import BENCHMARKS, table, write_section
from benchmarks.retrieval.data import DATASETS, half, in_processes, listed, unit_distances
from unbend import Parameters, compute_signature, read_mesh
from unbend.descriptors import moments as moments_module
from unbend.descriptors.moments import moments
from unbend.descriptors.quadrature import surface_quadrature
from unbend.descriptors.spectrum import Kernel, diffusion, gaussian, geodesic_spectrum
from unbend.matching.evaluate import RetrievalMetrics
from unbend.matching.evaluate.scores import score
from unbend.matching.measures import get_vector_measure
from unbend.matching.measures.vectors import COMBINED

Array = NDArray[Any]


def power(exponent: float) -> Kernel:
    """Return d^p; p = 1 is the geodesic distance matrix of Smeets et al. 2012."""
    return lambda distances, _shares: np.asarray(distances**exponent)


def exponential(rate: float) -> Kernel:
    """Return exp(-t d)."""
    return lambda distances, _shares: np.asarray(np.exp(-rate * distances))


MOST = 60  # eigenvalues of a kernel
WHOLE = (
    (("d^.75", 60),),
    (("exp(-d)", 60),),
    (("d^.75", 60), ("exp(-d)", 60)),
    (("d^.75", 60), ("exp(-d)", 60), ("d", 40)),
)
WIDTHS, COUNTS = {"diffusion": (0.1, 0.14, 0.2, 0.28), "gaussian": (0.2, 0.25, 0.3)}, (20, 30, 40)
MAKERS = {"diffusion": diffusion, "gaussian": gaussian}
KERNELS = {"d^.75": power(0.75), "exp(-d)": exponential(1.0), "d": power(1.0)} | {
    f"{name} {width}": MAKERS[name](width) for name, widths in WIDTHS.items() for width in widths
}
USED = (("d^.75", 60), ("diffusion 0.14", 20), ("gaussian 0.3", 40))
FORMER = WHOLE[-1]
MOMENTS, DISTRIBUTION = (0.0, 5.0, 10.0, 20.0, 40.0), (0.0, 5.0, 10.0, 20.0, 40.0)
BLURS = (0.0125, 0.025, 0.05, 0.1, 0.2)
MIXED = tuple(combinations_with_replacement(range(3), 3))
"""All ten third moments along three axes. Two are left out, because the paper has fewer than 15 numbers."""
DROPPED = tuple(combinations(range(len(MIXED)), 2))
USED_MOMENTS = (
    moments_module.BLUR,
    tuple(place for place, axes in enumerate(MIXED) if axes not in moments_module.MIXED),
)
METRICS = [list(RetrievalMetrics.__dataclass_fields__).index(name) for name in ("nn", "ft", "st", "map")]
SPLITS = 200

Choice = tuple[tuple[str, int], ...]


def candidates() -> list[Choice]:
    """Return all combinations of kernels of the whole surface, at most one diffusion and at most one Gaussian."""
    near = {
        name: [(), *(((f"{name} {width}", count),) for width, count in product(widths, COUNTS))]
        for name, widths in WIDTHS.items()
    }
    return [whole + walk + bell for whole, walk, bell in product(WHOLE, near["diffusion"], near["gaussian"])]


def describe(path: Path) -> dict[str, Array]:
    """Return the geodesic spectrum of a mesh under every kernel, and its other descriptors."""
    surface = read_mesh(path)
    signature = compute_signature(surface, Parameters(), threads=1)
    distances = unit_distances(surface, signature)
    spectra = {
        name: geodesic_spectrum(distances, signature.weights, ((kernel, MOST),)) for name, kernel in KERNELS.items()
    }
    points, weights = surface_quadrature(signature.points, signature.faces, signature.weights)
    points = points * signature.scale / np.sqrt(surface.area)
    shapes = {f"moments {blur}": moments(points, weights, blur=blur, mixed=MIXED) for blur in BLURS}
    return spectra | shapes | {name: signature.descriptors[name] for name in ("moments", "distribution")}


class DataSet:
    """The distances between all shapes of a data set, by a kernel or another descriptor."""

    def __init__(self, name: str) -> None:
        paths, labels = listed(name)
        self.labels = np.array(labels)
        self._described = in_processes(describe, paths)

    @cache  # noqa: B019
    def moments(self, blur: float, dropped: tuple[int, int]) -> Array:
        """Return distances between vectors of moments without the two `dropped` third moments."""
        vectors = np.stack([of[f"moments {blur}"] for of in self._described])
        kept = np.delete(vectors, 6 + np.array(dropped), axis=1).astype(np.float32)
        return get_vector_measure("moments").matrix(kept)

    @cache  # noqa: B019
    def distances(self, name: str, count: int | None = None) -> Array:
        vectors = np.stack([of[name][:count] for of in self._described]).astype(np.float32)
        return get_vector_measure("moments").matrix(vectors)

    def metrics(self, distances: Array) -> Array:
        """Return NN, FT, ST and AP of each query, (n, 4)."""
        codes = np.unique(self.labels, return_inverse=True)[1].astype(np.int32)
        return score(distances, codes, codes, np.arange(len(codes))).metrics[:, METRICS]


def spectrum(of: DataSet, choice: Choice) -> Array:
    return sum((of.distances(kernel, count) for kernel, count in choice), start=np.zeros(()))


def combined(of: DataSet, weights: tuple[float, float]) -> Array:
    moments, distribution = weights
    return spectrum(of, USED) + moments * of.distances("moments") + distribution * of.distances("distribution")


class Study:
    """The candidates, and the metrics of every query under each candidate."""

    def __init__(self, data: list[DataSet], names: list[Any], distances: Any) -> None:
        self._data, self._names = data, names
        self._metrics = [np.stack([of.metrics(distances(of, name)) for name in names]) for of in data]

    def best(self, chosen_on: list[Array]) -> Any:
        score = sum(metrics[:, rows, 3].mean(axis=1) for metrics, rows in zip(self._metrics, chosen_on, strict=True))
        return self._names[int(np.argmax(score))]

    def metrics_of(self, name: Any, rows: list[Array]) -> Array:
        place = self._names.index(name)
        found = [metrics[place][of].mean(axis=0) for metrics, of in zip(self._metrics, rows, strict=True)]
        return np.concatenate(found)

    def halved(self, which: int) -> list[Array]:
        return [half(of.labels.tolist(), which) for of in self._data]

    def rows(self) -> list[list[str]]:
        lines = []
        for which, name in enumerate(("first", "second")):
            best = self.best(self.halved(which))
            cells = _shown(self.metrics_of(best, self.halved(1 - which)))
            lines.append([f"chosen on the {name} half", _called(best), "the other half", *cells])
        return lines

    def over_splits(self) -> Array:
        """Return the metrics of the half that did not choose, as a mean over random halvings."""
        rng, found = np.random.default_rng(0), []
        for _ in range(SPLITS):
            halves = []
            for of in self._data:
                classes = rng.permutation(np.unique(of.labels))
                halves.append(np.isin(of.labels, classes[: len(classes) // 2]))
            found.append(self.metrics_of(self.best(halves), [~rows for rows in halves]))
        return np.mean(found, axis=0)


def _shown(metrics: Array) -> list[str]:
    return [f"{value:.3f}" for value in metrics]


def _called(choice: Any) -> str:
    if isinstance(choice[1], tuple) and isinstance(choice[0], float):
        return f"blur {choice[0]:g}, without {' and '.join(str(MIXED[place]) for place in choice[1])}"
    if all(isinstance(weight, float) for weight in choice):
        return "moments {:g}, distribution {:g}".format(*choice)
    return ", ".join(f"{kernel} ({count})" for kernel, count in choice)


def main() -> None:
    data = [DataSet(name) for name in DATASETS]
    everything = [np.ones(len(of.labels), bool) for of in data]
    kernels = Study(data, candidates(), spectrum)
    weights = Study(data, list(product(MOMENTS, DISTRIBUTION)), combined)
    third = Study(data, list(product(BLURS, DROPPED)), lambda of, choice: of.moments(*choice))
    used = tuple(dict(COMBINED.parts)[part] for part in ("moments", "distribution"))
    header = [
        "",
        "chosen",
        "evaluated on",
        *(f"{name} {figure}" for name in DATASETS for figure in ("NN", "FT", "ST", "mAP")),
    ]
    rows = [
        *kernels.rows(),
        [f"mean of {SPLITS} random halvings", "varies", "the other half", *_shown(kernels.over_splits())],
        ["current `spectrum`", _called(USED), "all classes", *_shown(kernels.metrics_of(USED, everything))],
        ["previous `spectrum`", _called(FORMER), "all classes", *_shown(kernels.metrics_of(FORMER, everything))],
    ]
    more = [
        *weights.rows(),
        ["current `combined`", _called(used), "all classes", *_shown(weights.metrics_of(used, everything))],
    ]
    last = [
        *third.rows(),
        [f"mean of {SPLITS} random halvings", "varies", "the other half", *_shown(third.over_splits())],
        [
            "current `moments`",
            _called(USED_MOMENTS),
            "all classes",
            *_shown(third.metrics_of(USED_MOMENTS, everything)),
        ],
    ]
    text = f"{len(candidates())} combinations of kernels for `spectrum`:\n\n{table(header, rows)}\n\n"
    text += f"{len(MOMENTS) * len(DISTRIBUTION)} weights of moments and distribution for `combined`:\n\n"
    text += table(header, more)
    text += f"\n\n{len(BLURS) * len(DROPPED)} variants of `moments`:\n\n{table(header, last)}"
    write_section(BENCHMARKS / "retrieval.md", "retrieval-choice", text)


if __name__ == "__main__":
    main()
