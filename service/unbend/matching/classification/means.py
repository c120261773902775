"""Class means, and the classifier that chooses the nearest class mean."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from scipy.sparse import csr_array

from unbend.arrays import Floats, Indices, Ints
from unbend.errors import ParameterError
from unbend.matching.classification.classifier import Classifier, ClassScores, Query
from unbend.matching.gallery import Gallery, cached_per_gallery

_BLOCK_ROWS: Final = 1 << 16
"""Number of rows that are converted to double precision at once: 80 MB in 160 dimensions."""


@dataclass(frozen=True)
class ClassMeans:
    """The number of members of each class, and their means."""

    counts: Ints
    """(classes,)."""
    means: Floats
    """(classes, d); infinite for a class without members."""

    def without(self, vector: Floats, code: int) -> Self:
        """Return the counts and means after the removal of one member."""
        counts, means = self.counts.copy(), self.means.copy()
        counts[code] -= 1
        means[code] = means[code] + (means[code] - vector) / counts[code] if counts[code] else np.inf
        return type(self)(counts, means)


@cached_per_gallery
def class_means(gallery: Gallery) -> ClassMeans:
    """Return the counts and means of all classes of `gallery`, computed in one pass.

    Raises
    ------
    ParameterError
        If a labelled vector contains a value that is not finite.
    """
    counts, sums = np.zeros(len(gallery.labels), np.int64), np.zeros((len(gallery.labels), gallery.vectors.shape[1]))
    for rows, vectors in labelled_blocks(gallery):
        finite = np.isfinite(vectors).all(axis=1)
        if not finite.all():
            raise ParameterError(f"row {rows[finite.argmin()]} of the gallery contains a value that is not finite")
        codes = gallery.codes[rows]
        counts += np.bincount(codes, minlength=len(counts))
        members = csr_array((np.ones(len(rows)), (codes, np.arange(len(rows)))), (len(counts), len(rows)))
        sums += np.asarray(members @ vectors)
    present = counts > 0
    means = np.full_like(sums, np.inf)
    means[present] = sums[present] / counts[present, None]
    return ClassMeans(counts, means)


def labelled_blocks(gallery: Gallery) -> Iterator[tuple[Indices, Floats]]:
    """Yield blocks of labelled rows and their vectors in double precision."""
    labelled = np.flatnonzero(gallery.codes >= 0)
    for start in range(0, len(labelled), _BLOCK_ROWS):
        rows = labelled[start : start + _BLOCK_ROWS]
        yield rows, gallery.vectors[rows].astype(np.float64)


def _score(query: Query) -> ClassScores:
    classes = class_means(query.gallery)
    for row in query.excluded:
        classes = classes.without(query.gallery.vectors[row].astype(np.float64), int(query.gallery.codes[row]))
    distances = query.measure.distances(query.vector, classes.means.astype(np.float32))
    return ClassScores(distances, distances)


MEAN: Final = Classifier("mean", _score)
"""The class of the nearest mean (Hastie et al. 2009, section 4.3), under the distance of the measure."""
