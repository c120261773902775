"""Samples of classes, from which the distances of classes that a search did not reach are estimated."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from unbend.arrays import Floats, Indices, Ints, Singles
from unbend.matching.measures import VectorMeasure

SAMPLE: Final = 16
"""Largest number of members that represent a class; an even number, because the estimate compares halves."""

_DAMPING: Final = 0.9
"""Logarithm of the growth by one doubling of a sample, over that by the doubling before (see `ClassSamples.absent`).

`benchmarks/cluster/search.py` measures the error of confidences on other vectors than those that chose it.
"""


@dataclass(frozen=True, eq=False)
class ClassSamples:
    """At most SAMPLE random members of each class, in random order within the class."""

    labels: tuple[str, ...]
    """The classes."""
    sizes: Ints
    """Number of members of each class, (c,); at least 1."""
    vectors: Singles
    """Members of the first class, then those of the second, and so on, (n, d): min(size, SAMPLE) of each class."""

    @cached_property
    def _starts(self) -> Indices:
        """The first row of each class, (c,)."""
        return np.concatenate([[0], np.cumsum(np.minimum(self.sizes, SAMPLE))[:-1]]).astype(np.int64)

    def absent(
        self, query: Singles, measure: VectorMeasure, present: Collection[str], beyond: float, exponent: float
    ) -> Floats:
        """Estimate the distances from a query to the nearest members of the classes that are not `present`.

        Parameters
        ----------
        query : (d,) float32
        measure : VectorMeasure
        present : collection of str
            The classes whose distances are known.
        beyond : float
            The distance within which every shape is known, so that no other class is nearer.
        exponent : float
            That of the classifier's confidences. The estimate is for the sum of the distances to the power -`exponent`.

        Returns
        -------
        (a,) float64

        Notes
        -----
        The nearest of a sample is farther than the nearest of its class. If each sample were twice as large, the sum
        would grow by a factor. The samples and their halves show the factor of the last doubling. Each further
        doubling multiplies the sum by less: the logarithm of its factor is _DAMPING times that of the one before.
        Classes that a sample contains wholly are exact.
        """
        chosen = np.array([label not in present for label in self.labels], bool)
        if not chosen.any():
            return np.empty(0)
        distances = np.maximum(measure.distances(query, self.vectors), beyond)
        nearest = np.minimum.reduceat(distances, self._starts)[chosen]
        larger = chosen & (self.sizes > SAMPLE)
        if not larger.any() or not beyond:
            return np.asarray(nearest)
        sampled = distances[self._starts[larger, None] + np.arange(SAMPLE)]
        halves = (sampled.reshape(-1, 2, SAMPLE // 2).min(axis=2) / beyond) ** -exponent
        growth = np.log(2 * halves.max(axis=1).sum() / halves.sum())
        doublings = np.log2(np.maximum(self.sizes[chosen] / SAMPLE, 1.0))
        grown = growth * _DAMPING * (1 - _DAMPING**doublings) / (1 - _DAMPING)
        return np.asarray(np.maximum(nearest * np.exp(-grown / exponent), beyond))
