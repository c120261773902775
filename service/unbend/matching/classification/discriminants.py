"""Regularised linear discriminants: distances to class means under the shrunk common covariance of all classes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from unbend.arrays import Floats, Ints
from unbend.errors import UnsuitedError
from unbend.matching.classification.classifier import Classifier, ClassScores, Query
from unbend.matching.classification.means import ClassMeans, class_means, labelled_blocks
from unbend.matching.gallery import Gallery, cached_per_gallery

MIN_MEMBERS: Final = 2
"""Least mean number of labelled shapes per class. A single member does not show how members differ."""


@dataclass(frozen=True)
class _Model:
    """Class means and scatter of a gallery, in the principal axes of the classes' common scatter."""

    axes: Floats
    """(d, d), one axis per column."""
    scatter: Floats
    """Sums of squared differences between members and their class means, along each axis, (d,)."""
    classes: ClassMeans
    """Counts and means, in coordinates along the axes."""


@cached_per_gallery
def _fit(gallery: Gallery) -> _Model:
    classes = class_means(gallery)
    scatter = np.zeros((gallery.vectors.shape[1], gallery.vectors.shape[1]))
    for rows, vectors in labelled_blocks(gallery):
        residuals = vectors - classes.means[gallery.codes[rows]]
        scatter += residuals.T @ residuals
    values, axes = np.linalg.eigh(scatter)
    present = classes.counts > 0
    means = np.full_like(classes.means, np.inf)
    means[present] = classes.means[present] @ axes
    return _Model(axes, np.maximum(values, 0.0), ClassMeans(classes.counts, means))


def _score(query: Query) -> ClassScores:
    """Return the Mahalanobis distance to each class mean, under the common covariance of the members.

    Excluded rows, such as that of a stored query, are subtracted from the means and the scatter. All classes have the
    same prior probability, because the number of stored shapes does not tell how likely queries of a class are.
    """
    gallery = query.gallery
    _check_labels(
        class_means(gallery).counts - np.bincount(gallery.codes[query.excluded], minlength=len(gallery.labels))
    )
    model = _fit(gallery)
    classes, removed = model.classes, np.zeros((len(model.axes), len(query.excluded)))
    for place, row in enumerate(query.excluded):
        vector, code = gallery.vectors[row] @ model.axes, int(gallery.codes[row])
        if (members := classes.counts[code]) > 1:
            removed[:, place] = np.sqrt(members / (members - 1)) * (vector - classes.means[code])
        classes = classes.without(vector, code)
    present = classes.counts > 0
    covariance = ShrunkCovariance.of(model.scatter, removed, int(classes.counts.sum() - present.sum()))
    distances = np.full(len(present), np.inf)
    distances[present] = covariance.mahalanobis_norms(classes.means[present] - query.vector @ model.axes)
    return ClassScores(distances, distances)


def _check_labels(counts: Ints) -> None:
    classes, members = np.count_nonzero(counts), counts.sum()
    if classes < 2 or members < MIN_MEMBERS * classes:
        raise UnsuitedError(
            f"discriminants need at least 2 classes and {MIN_MEMBERS} labelled shapes of each on average;"
            f" there are {classes} classes and {members} labelled shapes besides the query"
        )


@dataclass(frozen=True)
class ShrunkCovariance:
    """A covariance diag(variances) - factor * removed removed^T, shrunk towards a multiple of the identity.

    The matrix is never formed.
    """

    variances: Floats
    """(d,), above 0."""
    removed: Floats
    """(d, k)."""
    factor: float

    @classmethod
    def of(cls, scatter: Floats, removed: Floats, degrees_of_freedom: int) -> Self:
        """Shrink the covariance S / `degrees_of_freedom`, where S is diag(`scatter`) - `removed` `removed`^T.

        Parameters
        ----------
        scatter : (d,) float64
        removed : (d, k) float64
            The contribution to S of samples that are excluded. Its subtraction does not change the axes.
        degrees_of_freedom : int
            The number of samples minus the number of means subtracted from them.

        Notes
        -----
        The shrinkage is that of the oracle approximating estimator (Chen et al. 2010, eq. 23). It depends only on two
        traces, so it is exact for the remaining samples. If these do not differ at all, the result is the identity.
        """
        dimension = len(scatter)
        trace = float(scatter.sum() - (removed**2).sum())
        if trace <= dimension * np.finfo(float).eps * scatter.sum():
            return cls(np.ones(dimension), removed, 0.0)
        squared = float((scatter**2).sum() - 2 * (scatter @ removed**2).sum() + ((removed.T @ removed) ** 2).sum())
        shrinkage = _shrinkage(trace, squared, dimension, degrees_of_freedom)
        factor = (1 - shrinkage) / degrees_of_freedom
        return cls(factor * scatter + shrinkage * trace / (dimension * degrees_of_freedom), removed, factor)

    def mahalanobis_norms(self, differences: Floats) -> Floats:
        """Return the Mahalanobis norm of each row of `differences` (n, d), as (n,)."""
        scaled = differences / self.variances
        squares = np.einsum("nd,nd->n", scaled, differences)
        # Woodbury's identity inverts the covariance without forming it.
        projected = scaled @ self.removed
        inner = np.eye(self.removed.shape[1]) - self.factor * self.removed.T @ (self.removed / self.variances[:, None])
        squares += self.factor * np.einsum("nk,kn->n", projected, np.linalg.solve(inner, projected.T))
        return np.asarray(np.sqrt(np.maximum(squares, 0.0)))


def _shrinkage(trace: float, squared: float, dimension: int, degrees_of_freedom: int) -> float:
    """Return the weight of the identity, 0 to 1, from the traces of S and S S."""
    excess = (degrees_of_freedom + 1 - 2 / dimension) * (squared - trace**2 / dimension)
    return min(1.0, ((1 - 2 / dimension) * squared + trace**2) / excess) if excess > 0 else 1.0


DISCRIMINANTS: Final = Classifier("discriminants", _score)
"""Linear discriminants of a shrunk covariance (Friedman 1989), with the shrinkage of Chen et al. 2010."""
