"""Regularised linear discriminants: class means, told apart by the directions in which members do not differ."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from unbend.arrays import Floats, Ints
from unbend.errors import UnsuitedError
from unbend.matching.classification.classifier import Classifier, Judgement
from unbend.matching.classification.learned import once_a_gallery
from unbend.matching.classification.means import ClassMeans, class_means, labelled_blocks
from unbend.matching.classification.query import Query
from unbend.matching.classification.shrinkage import Metric
from unbend.matching.gallery import Gallery

MEMBERS: Final = 2
"""Labelled shapes a class, on average: from one nothing is learned of how members differ."""


@dataclass(frozen=True)
class _Learned:
    """What a gallery teaches, in the axes of its classes' common scatter."""

    axes: Floats
    """(d, d), a column each."""
    scatter: Floats
    """Sums of squared differences from the members' class means along the axes, (d,)."""
    classes: ClassMeans
    """Along the axes."""


@once_a_gallery
def _learn(gallery: Gallery) -> _Learned:
    classes = class_means(gallery)
    scatter = np.zeros((gallery.vectors.shape[1], gallery.vectors.shape[1]))
    for rows, vectors in labelled_blocks(gallery):
        residuals = vectors - classes.means[gallery.codes[rows]]
        scatter += residuals.T @ residuals
    values, axes = np.linalg.eigh(scatter)
    present = classes.counts > 0
    means = np.full_like(classes.means, np.inf)
    means[present] = classes.means[present] @ axes
    return _Learned(axes, np.maximum(values, 0.0), ClassMeans(classes.counts, means))


def _judge(query: Query) -> Judgement:
    """Measure from the query to each class' mean in the metric of the members' common covariance (Mahalanobis).

    A stored query is no part of what it is compared with: its share of the means and the scatter is taken off.
    All classes are as likely beforehand: how many shapes of them are stored says nothing of what is asked.
    """
    gallery = query.gallery
    _check_labels(
        class_means(gallery).counts - np.bincount(gallery.codes[query.left_out], minlength=len(gallery.labels))
    )
    learned = _learn(gallery)
    classes, lost = learned.classes, np.zeros((len(learned.axes), len(query.left_out)))
    for place, row in enumerate(query.left_out):
        vector, code = gallery.vectors[row] @ learned.axes, int(gallery.codes[row])
        if (members := classes.counts[code]) > 1:
            lost[:, place] = np.sqrt(members / (members - 1)) * (vector - classes.means[code])
        classes = classes.without(vector, code)
    present = classes.counts > 0
    metric = Metric.of(learned.scatter, lost, int(classes.counts.sum() - present.sum()))
    distances = np.full(len(present), np.inf)
    distances[present] = metric.lengths(classes.means[present] - query.vector @ learned.axes)
    return Judgement(distances, distances)


def _check_labels(counts: Ints) -> None:
    classes, members = np.count_nonzero(counts), counts.sum()
    if classes < 2 or members < MEMBERS * classes:
        raise UnsuitedError(
            f"discriminants are learned from at least 2 classes and {MEMBERS} labelled shapes of each on average;"
            f" there are {classes} classes and {members} labelled shapes besides the query"
        )


DISCRIMINANTS: Final = Classifier(
    name="discriminants",
    needs=MEMBERS,
    reference="Friedman 1989: linear discriminants of a shrunk covariance; how much it is shrunk: Chen et al. 2010",
    judge=_judge,
)
