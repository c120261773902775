"""What a classifier is asked."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from unbend.arrays import Floats, Indices, Singles
from unbend.matching.gallery import Gallery
from unbend.matching.measures import VectorMeasure
from unbend.matching.selection import nearest_of_each_class


@dataclass(frozen=True)
class Query:
    """A vector, and the gallery that holds the classes. Rows at no finite distance take no part."""

    gallery: Gallery
    measure: VectorMeasure
    vector: Singles
    """(d,)."""
    distances: Floats
    """To each row of the gallery, (n,); infinite for rows to be left out, as the query's own."""

    @cached_property
    def nearest(self) -> Floats:
        """Distance to each class' nearest member, (classes,); infinite where it has none."""
        return nearest_of_each_class(self.distances, self.gallery.codes, len(self.gallery.labels))

    @cached_property
    def left_out(self) -> Indices:
        """Rows that have a class but take no part."""
        return np.flatnonzero(~(self.distances < np.inf) & (self.gallery.codes >= 0))
