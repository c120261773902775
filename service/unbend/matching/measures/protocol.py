"""What a measure is. All are symmetric, zero between equal signatures, and depend on nothing but the two."""

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
        """What callers choose it by."""

    @property
    def invariances(self) -> tuple[str, ...]:
        """What a shape may undergo without a change but for sampling."""

    @property
    def cost(self) -> str:
        """What a comparison takes."""

    @property
    def reference(self) -> str:
        """Where it comes from."""

    def distance(self, a: Signature, b: Signature) -> float:
        """Return how far `a` and `b` are apart."""


@dataclass(frozen=True)
class VectorMeasure:
    """A distance between vectors that signatures carry: the sum of absolute differences (L1).

    L1 is less swayed by a single large difference than L2. Several descriptors with fixed weights are one vector,
    for the sum of their weighted distances is the distance between their weighted vectors. Vectors are of single
    precision, so that a million of them can be searched in memory; geodesic distances are no more precise.
    """

    name: str
    invariances: tuple[str, ...]
    reference: str
    parts: tuple[tuple[str, float], ...]
    """Names of the descriptors that make the vector, and the weight of each."""

    @property
    def cost(self) -> str:
        """What a comparison takes."""
        return "one pass over two vectors"

    def vector(self, descriptors: Mapping[str, Floats]) -> Singles:
        """Return the vector that stands for a signature with these descriptors, (d,)."""
        return np.concatenate([weight * descriptors[part] for part, weight in self.parts]).astype(np.float32)

    def distances(self, query: Singles, gallery: Singles) -> Floats:
        """Return the distance from `query` (d,) to each row of `gallery` (n, d), as (n,)."""
        return scan(query, gallery)

    def between(self, queries: Singles, gallery: Singles) -> Floats:
        """Return the distance from each row of `queries` (q, d) to each of `gallery` (n, d), as (q, n)."""
        found = np.empty((len(queries), len(gallery)))
        for row, query in enumerate(queries):
            found[row] = self.distances(query, gallery)
        return found

    def matrix(self, vectors: Singles) -> Floats:
        """Return all distances between the rows of `vectors` (n, d), as (n, n)."""
        return self.between(vectors, vectors)

    def distance(self, a: Signature, b: Signature) -> float:
        """Return how far `a` and `b` are apart."""
        return float(self.distances(self.vector(a.descriptors), self.vector(b.descriptors)[None])[0])


@dataclass(frozen=True)
class SquaredMeasure(VectorMeasure):
    """The sum of squared differences of the same vectors: the paper's D_M, where these are moments (section 2.3)."""

    def distances(self, query: Singles, gallery: Singles) -> Floats:
        """Return the squared L2 distance from `query` (d,) to each row of `gallery` (n, d), as (n,)."""
        differences = gallery.astype(np.float64) - query
        return np.asarray(np.einsum("ij,ij->i", differences, differences))


def squared(measure: VectorMeasure) -> SquaredMeasure:
    """Return the measure that adds up squared differences where `measure` adds up absolute ones."""
    return SquaredMeasure(measure.name, measure.invariances, measure.reference, measure.parts)


@dataclass(frozen=True)
class PairMeasure:
    """A distance that needs both signatures whole. Too dear for all of a library: it orders a short list anew."""

    name: str
    invariances: tuple[str, ...]
    reference: str
    cost: str
    distance: Callable[[Signature, Signature], float]
