"""The time of classification beyond the distances, in libraries of ten thousand and a million shapes."""

from __future__ import annotations

import time

import numpy as np

from benchmarks.common import best_of, table
from unbend.matching.classification import CLASSIFIERS, classify
from unbend.matching.gallery import Gallery
from unbend.matching.measures import DEFAULT_MEASURE, get_vector_measure

SIZES = (10_000, 1_000_000)
MEMBERS = 1000


def tables(dimension: int) -> tuple[str, str]:
    measured = [_costs(size, dimension) for size in SIZES]
    rows = [[name, *(f"{1e3 * seconds:.2f}" for costs in measured for seconds in costs[name])] for name in CLASSIFIERS]
    text = (
        f"**Cost** of `classify` beyond the distances, ms: random vectors of {dimension} numbers in classes of"
        f" {MEMBERS}. The first query computes what the classifier caches for the library; stored: a query that is"
        " itself in the library."
    )
    header = ["classifier", *(f"{size:,}: {which}" for size in SIZES for which in ("first", "next", "stored"))]
    return text, table(header, rows)


def _costs(size: int, dimension: int) -> dict[str, tuple[float, float, float]]:
    generator = np.random.default_rng(0)
    codes = generator.permutation(np.arange(size, dtype=np.int32) % (size // MEMBERS))
    vectors = generator.random((size, dimension), np.float32)
    labels = tuple(f"class {code}" for code in range(size // MEMBERS))
    measure, query = get_vector_measure(DEFAULT_MEASURE), vectors[0].copy()
    distances = measure.distances(query, vectors)
    stored = np.where(np.arange(size) == 0, np.inf, distances)
    costs = {}
    for name in CLASSIFIERS:
        gallery = Gallery(vectors, codes, labels)  # a new gallery, for which no classifier has cached anything
        start = time.perf_counter()
        classify(gallery, measure, query, distances, name)
        first = time.perf_counter() - start
        later = (
            best_of(3, lambda to=to, gallery=gallery, name=name: classify(gallery, measure, query, to, name))
            for to in (distances, stored)
        )
        costs[name] = (first, *later)
    return costs
