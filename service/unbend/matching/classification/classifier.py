"""The types that every classifier uses: a query, the scores of the classes, and the classifier itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from unbend.arrays import Floats, Indices, Singles
from unbend.matching.gallery import Gallery
from unbend.matching.measures import VectorMeasure
from unbend.matching.selection import nearest_of_each_class


@dataclass(frozen=True)
class Query:
    """A vector to classify, and its distances to a gallery. Rows at infinite distance are excluded."""

    gallery: Gallery
    measure: VectorMeasure
    vector: Singles
    """(d,)."""
    distances: Floats
    """Distance to each row of the gallery, (n,); infinite for excluded rows, such as the query itself."""

    @cached_property
    def nearest(self) -> Floats:
        """Distance to the nearest member of each class, (classes,); infinite for a class without members."""
        return nearest_of_each_class(self.distances, self.gallery.codes, len(self.gallery.labels))

    @cached_property
    def excluded(self) -> Indices:
        """The excluded rows that have a label."""
        return np.flatnonzero(~(self.distances < np.inf) & (self.gallery.codes >= 0))


class ClassScores(NamedTuple):
    """Two values for each class of a gallery; infinite for a class without members."""

    dissimilarities: Floats
    """Values that determine the order of classes and the confidences, (classes,); at least 0, in any unit."""
    distances: Floats
    """Distances that users see, (classes,)."""


@dataclass(frozen=True)
class Classifier:
    """A way to compare a query with classes. The result depends only on the query and the gallery."""

    name: str
    """The name by which callers choose the classifier."""
    score: Callable[[Query], ClassScores]
    """Scores the classes, and raises ParameterError if the gallery has too few labels."""
