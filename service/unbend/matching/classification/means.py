"""The means of classes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from scipy.sparse import csr_array

from unbend.arrays import Floats, Indices, Ints
from unbend.errors import ParameterError
from unbend.matching.classification.classifier import Classifier, Judgement
from unbend.matching.classification.learned import once_a_gallery
from unbend.matching.classification.query import Query
from unbend.matching.gallery import Gallery

_ROWS: Final = 1 << 16
"""Rows that are taken in double precision at a time: 80 MB of them, in 160 dimensions."""


@dataclass(frozen=True)
class ClassMeans:
    """How many members each class has, and their mean."""

    counts: Ints
    """(classes,)."""
    means: Floats
    """(classes, d); infinite where a class has no members."""

    def without(self, vector: Floats, code: int) -> Self:
        """Return the same without one member."""
        counts, means = self.counts.copy(), self.means.copy()
        counts[code] -= 1
        means[code] = means[code] + (means[code] - vector) / counts[code] if counts[code] else np.inf
        return type(self)(counts, means)


@once_a_gallery
def class_means(gallery: Gallery) -> ClassMeans:
    """Return the counts and means of all classes of `gallery`, from one pass over it.

    Raises
    ------
    ParameterError
        If a labelled vector holds a number that is not finite.
    """
    counts, sums = np.zeros(len(gallery.labels), np.int64), np.zeros((len(gallery.labels), gallery.vectors.shape[1]))
    for rows, vectors in labelled_blocks(gallery):
        finite = np.isfinite(vectors).all(axis=1)
        if not finite.all():
            raise ParameterError(f"row {rows[finite.argmin()]} of the gallery holds a number that is not finite")
        codes = gallery.codes[rows]
        counts += np.bincount(codes, minlength=len(counts))
        members = csr_array((np.ones(len(rows)), (codes, np.arange(len(rows)))), (len(counts), len(rows)))
        sums += np.asarray(members @ vectors)
    present = counts > 0
    means = np.full_like(sums, np.inf)
    means[present] = sums[present] / counts[present, None]
    return ClassMeans(counts, means)


def labelled_blocks(gallery: Gallery) -> Iterator[tuple[Indices, Floats]]:
    """Yield the rows that have a class and their vectors in double precision, some at a time."""
    labelled = np.flatnonzero(gallery.codes >= 0)
    for start in range(0, len(labelled), _ROWS):
        rows = labelled[start : start + _ROWS]
        yield rows, gallery.vectors[rows].astype(np.float64)


def _judge(query: Query) -> Judgement:
    classes = class_means(query.gallery)
    for row in query.left_out:
        classes = classes.without(query.gallery.vectors[row].astype(np.float64), int(query.gallery.codes[row]))
    distances = query.measure.distances(query.vector, classes.means.astype(np.float32))
    return Judgement(distances, distances)


MEAN: Final = Classifier(
    name="mean",
    needs=1,
    reference="Hastie et al. 2009, section 4.3: the nearest class mean, here under the measure's own distance",
    judge=_judge,
)
