"""The types of measures.

Every measure is symmetric, is zero for equal signatures, and depends only on the two signatures.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from unbend.arrays import Floats, Singles
from unbend.matching.scan import scan
from unbend.signature.signature import Signature


class Measure(Protocol):
    """A distance between signatures."""

    @property
    def name(self) -> str:
        """The name by which callers choose the measure."""

    def distance(self, a: Signature, b: Signature) -> float:
        """Return the distance between `a` and `b`."""


@dataclass(frozen=True)
class VectorMeasure:
    """A distance between vectors made from descriptors: the sum of absolute differences (L1).

    A single large difference affects L1 less than L2. Several descriptors, each with a fixed weight, are concatenated
    to one vector, because the sum of their weighted distances is the distance between the weighted vectors. Vectors
    have single precision, so that a million of them fit in memory. Geodesic distances are no more precise than that.
    """

    name: str
    parts: tuple[tuple[str, float], ...]
    """Names and weights of the descriptors in the vector."""

    def vector(self, descriptors: Mapping[str, Floats]) -> Singles:
        """Return the vector, (d,), of a signature with these descriptors."""
        return np.concatenate([weight * descriptors[part] for part, weight in self.parts]).astype(np.float32)

    def distances(self, query: Singles, gallery: Singles) -> Floats:
        """Return the distance from `query` (d,) to each row of `gallery` (n, d), as (n,)."""
        return scan(query, gallery)

    def between(self, queries: Singles, gallery: Singles) -> Floats:
        """Return the distance from each row of `queries` (q, d) to each of `gallery` (n, d), as (q, n)."""
        distances = np.empty((len(queries), len(gallery)))
        for row, query in enumerate(queries):
            distances[row] = self.distances(query, gallery)
        return distances

    def matrix(self, vectors: Singles) -> Floats:
        """Return all distances between the rows of `vectors` (n, d), as (n, n)."""
        return self.between(vectors, vectors)

    def distance(self, a: Signature, b: Signature) -> float:
        """Return the distance between `a` and `b`."""
        return float(self.distances(self.vector(a.descriptors), self.vector(b.descriptors)[None])[0])


@dataclass(frozen=True)
class SquaredMeasure(VectorMeasure):
    """The sum of squared differences between vectors. For moments this is the paper's D_M (section 2.3)."""

    def distances(self, query: Singles, gallery: Singles) -> Floats:
        """Return the squared L2 distance from `query` (d,) to each row of `gallery` (n, d), as (n,)."""
        differences = gallery.astype(np.float64) - query
        return np.asarray(np.einsum("ij,ij->i", differences, differences))


def squared(measure: VectorMeasure) -> SquaredMeasure:
    """Return `measure` with squared differences instead of absolute ones."""
    return SquaredMeasure(measure.name, measure.parts)


@dataclass(frozen=True)
class PairMeasure:
    """A distance that needs two whole signatures.

    It is too slow for a search of a whole library, so it only reranks a short list.
    """

    name: str
    distance: Callable[[Signature, Signature], float]
