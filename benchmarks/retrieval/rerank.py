"""Retrieval by pair measures: on the short list of the default measure, and alone.

The classes of each data set alternate by name between two halves, A and B. Choices (the modified Hausdorff distance,
the length of the short list) were made on A only. Writes the section "rerank" of docs/benchmarks/retrieval.md.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from benchmarks.common import BENCHMARKS, table, write_section
from benchmarks.retrieval.data import half, listed, signatures_of
from unbend.arrays import Floats, Indices
from unbend.matching.evaluate import RetrievalMetrics, evaluate
from unbend.matching.measures import DEFAULT_MEASURE, get_vector_measure
from unbend.matching.measures.alignment import Search, align
from unbend.matching.measures.pairs import RIGID, farthest, larger_mean, root_mean_square
from unbend.matching.rerank import rerank
from unbend.signature.parameters import Parameters
from unbend.signature.signature import Signature
from unbend.threads import share_out

LENGTHS = (5, 10, 20)
EVERY = {"shrec11_simplified": 3, "tosca5k": 1, "shrec07": 1}
"""Without a short list, pair measures are tried on every n-th class: ten classes of SHREC'11."""
REFERENCE = Search(kept=48, marker_steps=1, refined=48)
"""A search that refines every start with all points."""


PAIRED = {"rigid": root_mean_square, "hausdorff": larger_mean, "max_hausdorff": farthest}


@dataclass(frozen=True)
class Shapes:
    """A data set, or some of its classes."""

    name: str
    labels: np.ndarray
    signatures: Sequence[Signature]

    @cached_property
    def first(self) -> Floats:
        """The distances by the default measure, (n, n)."""
        measure = get_vector_measure(DEFAULT_MEASURE)
        return measure.matrix(np.stack([measure.vector(signature.descriptors) for signature in self.signatures]))

    def every(self, step: int) -> Shapes:
        """Return the shapes of every `step`-th class."""
        rows = np.flatnonzero(np.isin(self.labels, np.unique(self.labels)[::step]))
        return Shapes(self.name, self.labels[rows], [self.signatures[row] for row in rows])

    def halves(self, distances: Floats) -> list[RetrievalMetrics]:
        """Return the metrics of queries from the classes A and from the classes B, among all shapes."""
        asked = [np.flatnonzero(half(self.labels, which)) for which in (0, 1)]
        return [evaluate(distances[rows], self.labels[rows], self.labels, own=rows).metrics for rows in asked]

    def pair_distances(self, pairs: Iterable[tuple[int, int]]) -> dict[str, Floats]:
        """Return the distances of every pair measure between these pairs, (n, n); NaN elsewhere, 0 on the diagonal."""
        wanted = sorted({(min(pair), max(pair)) for pair in pairs} - {(row, row) for row in range(len(self.labels))})
        distances = np.full((len(PAIRED), len(self.labels), len(self.labels)), np.nan)
        distances[:, range(len(self.labels)), range(len(self.labels))] = 0.0

        def fill(part: slice) -> None:
            for i, j in wanted[part]:
                found = align(self.signatures[i], self.signatures[j])
                values = [min(map(measure, found)) for measure in PAIRED.values()]
                distances[:, i, j] = distances[:, j, i] = values

        share_out(len(wanted), None, fill)
        return dict(zip(PAIRED, distances, strict=True))

    def short_list(self, query: int, length: int) -> Indices:
        """Return the nearest other shapes by the default measure."""
        order = np.argsort(self.first[query], kind="stable")
        return order[order != query][:length]

    def reordered(self, scores: Floats, length: int) -> Floats:
        """Return ranks in which each query's short list is ordered by score and precedes all other shapes."""
        places = np.argsort(np.argsort(self.first, axis=1, kind="stable"), axis=1) + float(length)
        for query in range(len(places)):
            rows = self.short_list(query, length)
            places[query, rows[np.argsort(scores[query, rows], kind="stable")]] = np.arange(length)
        return places


def main() -> None:
    data = {name: load(name) for name in EVERY}
    alone, lists, changes = [], [], []
    for name, shapes in data.items():
        some = shapes.every(EVERY[name])
        size = len(some.labels)
        paired = some.pair_distances((i, j) for i in range(size) for j in range(i))
        title = f"{name} ({size} of {len(shapes.labels)})"
        for measure, distances in {DEFAULT_MEASURE: some.first, **paired}.items():
            alone.append([title, measure, *map(shown, some.halves(distances))])
        if some.labels.size < shapes.labels.size:
            listed = {(i, j) for i in range(len(shapes.labels)) for j in shapes.short_list(i, max(LENGTHS))}
            paired = shapes.pair_distances(listed)
        lists += list_rows(shapes, paired, changes)
    text = "\n\n".join((alone_text(alone), list_text(lists), change_text(changes), search_text(data)))
    write_section(BENCHMARKS / "retrieval.md", "rerank", text)


def load(dataset: str) -> Shapes:
    paths, labels = listed(dataset)
    return Shapes(dataset, np.array(labels), signatures_of(paths, Parameters()))


def shown(metrics: RetrievalMetrics) -> str:
    return f"{metrics.nn:.3f} / {metrics.ft:.3f} / {metrics.map:.3f}"


def list_rows(shapes: Shapes, paired: dict[str, Floats], changes: list[tuple[str, int, float]]) -> list[list[object]]:
    before = shapes.halves(shapes.first)
    rows: list[list[object]] = [[shapes.name, 0, "", *map(shown, before)]]
    for length in LENGTHS:
        for measure in ("rigid", "hausdorff"):
            for name, scores in ((measure, paired[measure]), (f"{measure} x first", paired[measure] * shapes.first)):
                after = shapes.halves(shapes.reordered(scores, length))
                rows.append([shapes.name, length, name, *map(shown, after)])
                changes.append((name, length, after[0].map - before[0].map))
    return rows


def alone_text(rows: list[list[object]]) -> str:
    return (
        "NN / FT / mAP of queries from the two halves of the classes, A and B (every second one, by name), among all"
        " shapes. A was used to choose the modified Hausdorff distance instead of the true one, and the length of the"
        " short list.\n\n**Alone**: every pair is compared:\n\n" + table(["data set", "measure", "A", "B"], rows)
    )


def list_text(rows: list[list[object]]) -> str:
    return (
        f"**Short lists**: the nearest shapes by {DEFAULT_MEASURE}, sorted by a pair measure, or by the product of both"
        " distances (x first).\n\n" + table(["data set", "length", "order", "A", "B"], rows)
    )


def change_text(changes: list[tuple[str, int, float]]) -> str:
    rows = [
        [name, *(f"{np.mean([c for n, k, c in changes if (n, k) == (name, length)]):+.4f}" for length in LENGTHS)]
        for name in dict.fromkeys(name for name, _, _ in changes)
    ]
    return (
        "**Length of the short list**: change of the mAP of A by reordering, mean of the data sets.\n\n"
        + table(["order", *map(str, LENGTHS)], rows)
    )  # fmt: skip


def search_text(data: dict[str, Shapes]) -> str:
    rows = []
    for shapes in data.values():
        random = np.random.default_rng(0)
        ratios: dict[bool, list[float]] = {True: [], False: []}
        for query in random.choice(len(shapes.labels), 20, replace=False):
            inside = shapes.labels == shapes.labels[query]
            inside_others = np.flatnonzero(inside & (np.arange(len(inside)) != query))
            for same, others in ((True, inside_others), (False, np.flatnonzero(~inside))):
                if len(others):
                    pair = shapes.signatures[query], shapes.signatures[random.choice(others)]
                    best = min(map(root_mean_square, align(*pair, REFERENCE)))
                    ratios[same].append(min(map(root_mean_square, align(*pair))) / best)
        cells = [f"{np.mean(found):.3f} / {np.max(found):.3f}" for found in ratios.values()]
        samples = max(len(signature.weights) for signature in shapes.signatures)
        times = [f"{1e3 * seconds_a_pair(shapes, threads):.1f}" for threads in (1, None)]
        rows.append([shapes.name, samples, *cells, *times])
    header = [
        "data set",
        "samples",
        "same class: mean / largest",
        "other class: mean / largest",
        "ms per pair, one thread",
        "all threads",
    ]
    return (
        "**Search**: the distance that `rigid` finds, divided by the smallest that is found if all 48 starts are"
        " refined with all points; and the time that `rigid` takes.\n\n" + table(header, rows)
    )


def seconds_a_pair(shapes: Shapes, threads: int | None) -> float:
    candidates = shapes.signatures[1:41]
    seconds = []
    for _ in range(3):
        start = time.perf_counter()
        rerank(shapes.signatures[0], candidates, RIGID, threads)
        seconds.append(time.perf_counter() - start)
    return min(seconds) / len(candidates)


if __name__ == "__main__":
    main()
