"""How good a map of a piece is: distances, directions, looks, and the orientation of triangles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from unbend.arrays import Floats, Indices
from unbend.correspondence.correspondence import Candidate
from unbend.correspondence.parts.directions import Directions
from unbend.correspondence.parts.looks import curvature_differs
from unbend.correspondence.parts.orientation import agreement
from unbend.correspondence.parts.pairs import Pairs
from unbend.correspondence.parts.views import View

_LEAST_AGREEMENT: Final = 0.2
"""Least agreement of triangles in a map that has the wanted orientation."""

_SOME: Final = 0.2
"""Added to the difference of circles, which is near 0 if a piece is so narrow that few circles fit in it."""


@dataclass(frozen=True, eq=False)
class Map:
    """Images of the S samples of a piece."""

    images: Indices  # (S,) vertices of the whole
    there: Floats  # (S, S) distances between them
    courses: Directions  # (S, S) directions at each, away from all others
    rings: Floats  # (S,) differences of the circles
    turn: float
    """1 if it was to keep the orientation, -1 to reverse it, 0 for neither."""


@dataclass(frozen=True)
class Judgement:
    """The figures of a map."""

    figures: Candidate
    turn: float
    oriented: bool
    """Whether it has the orientation that was asked for."""

    def sort_key(self) -> tuple[bool, float]:
        """Return a key that puts the better map first."""
        return self.turn != 0 and not self.oriented, self.figures.cost


def judge(part: View, whole: View, pairs: Pairs, found: Map) -> Judgement:
    """Measure a map. No single figure tells right maps from wrong ones; the cost, a product of several, does."""
    mean = part.weights
    errors = np.maximum(np.maximum(found.there - pairs.high, pairs.low - found.there), 0.0)
    squared = (errors * pairs.precision) ** 2
    strain = float(mean @ (pairs.weights * squared / (1.0 + squared)).sum(axis=1))
    curved = float(mean @ curvature_differs(part, whole, part.samples, found.images))
    cost = strain * curved * (float(mean @ found.rings) + _SOME)
    if found.turn:
        sums = np.abs((pairs.clear * found.courses * pairs.courses.conj()).sum(axis=1))
        known = np.maximum(pairs.clear.sum(axis=1), np.finfo(np.float64).tiny)
        cost *= float(mean @ (1.0 - sums / known))
    agreed = agreement(part, whole, found.images) * (found.turn or 1.0)
    stretch = float(mean @ (pairs.weights * errors).sum(axis=1))
    bent = part.curvatures[part.samples] - whole.curvatures[found.images]
    figures = Candidate(cost, stretch, float(mean @ (bent**2).mean(axis=1)), agreed, 0.0)
    return Judgement(figures, found.turn, found.turn != 0 and agreed >= _LEAST_AGREEMENT)
