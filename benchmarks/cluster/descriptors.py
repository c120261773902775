"""Any number of descriptors that are drawn from real ones: made-up classes of shapes in made-up poses.

The real descriptors are those of SHREC'11, SHREC'07, TOSCA and FAUST (`real`).

**A made-up class** lies between two real shapes of different classes. Its centre is (1 - t) a + t b, where t is uniform
in [0, 1]. Logarithms of eigenvalues are combined, so this is a geometric mean of the eigenvalues.

**A pose** is the centre plus a random vector that has the covariance of real poses within a class. Half of the
covariance is that of a random real class, which gives a made-up class a character of its own. The other half is that of
all real classes together, which gives poses the full number of dimensions. So poses differ as much as real ones
(`benchmarks/cluster/search.py` prints both). At last the numbers of each kernel are sorted, as eigenvalues are.

**A query** is a new pose of a made-up class that has stored shapes, or, for each tenth query, of one that has none.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from benchmarks.retrieval.data import listed, signatures_of
from unbend.arrays import Indices, Singles
from unbend.descriptors.spectrum import KERNELS
from unbend.matching.measures import DEFAULT_MEASURE, get_vector_measure
from unbend.signature.parameters import Parameters

MEASURE = get_vector_measure(DEFAULT_MEASURE)
DATASETS = ("shrec11_simplified", "shrec07", "tosca5k", "faust5k")
LARGE_SHARE, LARGE_CLASSES = 0.01, 20
"""The largest classes have one shape in a hundred each."""
MEMBERS = 100
"""Shapes of each other class."""
STRANGE = 10
"""One query in ten belongs to no stored class."""


@dataclass(frozen=True, eq=False)
class Real:
    """Descriptors of real shapes, (n, 120), and their classes, (n,)."""

    vectors: Singles
    labels: np.ndarray

    @cached_property
    def residuals(self) -> list[Singles]:
        """Differences of the members of each class from their mean, scaled to have the covariance of the class."""
        classes = [self.vectors[self.labels == label] for label in np.unique(self.labels)]
        return [(each - each.mean(axis=0)) / np.sqrt(len(each) - 1) for each in classes if len(each) > 2]

    @cached_property
    def all_residuals(self) -> Singles:
        """The same of all classes together."""
        return np.concatenate(self.residuals) / np.float32(np.sqrt(len(self.residuals)))


def real(cache: Path) -> Real:
    """Return the descriptors of the real shapes; they are computed once, which takes minutes, and kept in `cache`."""
    if not cache.exists():
        vectors, labels = [], []
        for dataset in DATASETS:
            paths, classes = listed(dataset, merged=False)
            vectors += [MEASURE.vector(each.descriptors) for each in signatures_of(paths, Parameters())]
            labels += [f"{dataset} {label}" for label in classes]
        np.savez(cache, vectors=np.stack(vectors), labels=np.array(labels))
    with np.load(cache) as file:
        return Real(file["vectors"], file["labels"])


@dataclass(frozen=True, eq=False)
class Drawn:
    """Made-up shapes: vectors (n, 120), classes (n,); queries (q, 120), their classes (q,), -1 if not stored."""

    vectors: Singles
    codes: Indices
    queries: Singles
    query_codes: Indices


def draw(base: Real, size: int, queries: int, seed: int = 1) -> Drawn:
    """Return `size` made-up shapes in random order, and `queries` made-up queries."""
    random = np.random.default_rng(seed)
    codes = random.permutation(_class_of_each(size))
    classes = int(codes.max()) + 1
    centres, characters = _classes(base, classes + queries, random)
    vectors = _poses(base, centres, characters, codes, random)
    asked = codes[random.integers(0, size, queries)]
    strange = np.arange(queries) % STRANGE == 0
    asked[strange] = classes + np.flatnonzero(strange)
    found = _poses(base, centres, characters, asked, random)
    return Drawn(vectors, codes, found, np.where(strange, -1, asked))


def _class_of_each(size: int) -> Indices:
    large = int(size * LARGE_SHARE)
    rest = np.arange(size - LARGE_CLASSES * large) // MEMBERS + LARGE_CLASSES
    return np.concatenate([np.repeat(np.arange(LARGE_CLASSES), large), rest])


def _classes(base: Real, count: int, random: np.random.Generator) -> tuple[Singles, Indices]:
    """Return the centre of each class, and the real class that gives its poses their character."""
    first, second = random.integers(0, len(base.labels), (2, count))
    while (same := base.labels[first] == base.labels[second]).any():
        second[same] = random.integers(0, len(base.labels), same.sum())
    share = random.random((count, 1), np.float32)
    return (1 - share) * base.vectors[first] + share * base.vectors[second], random.integers(
        0, len(base.residuals), count
    )


def _poses(base: Real, centres: Singles, characters: Indices, codes: Indices, random: np.random.Generator) -> Singles:
    """Return a new pose of the class of each of `codes`."""
    result = np.empty((len(codes), centres.shape[1]), np.float32)
    half = np.float32(np.sqrt(0.5))
    for character, own in enumerate(base.residuals):
        rows = np.flatnonzero(characters[codes] == character)
        poses = centres[codes[rows]]
        for residuals in (own, base.all_residuals):
            poses += half * (random.standard_normal((len(rows), len(residuals)), np.float32) @ residuals)
        result[rows] = poses
    start = 0
    for _, kept in KERNELS:
        result[:, start : start + kept] = -np.sort(-result[:, start : start + kept], axis=1)
        start += kept
    return result
