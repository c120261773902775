"""Places of samples of a piece among the samples of its whole."""

from __future__ import annotations

from typing import Final

import numpy as np

from unbend.arrays import Floats, Indices
from unbend.correspondence.parts.assignment import TURNING, assign
from unbend.correspondence.parts.directions import Directions
from unbend.correspondence.parts.looks import Looks, sample_looks
from unbend.correspondence.parts.pairs import Pairs, pairs_of
from unbend.correspondence.parts.views import View

SCALE: Final = 0.3
"""Distance over the square root of the area at which a pair counts a third."""


class Placing:
    """The surfaces and comparisons that all placings of samples share."""

    def __init__(self, part: View, whole: View, turn: float) -> None:
        """Compare all samples of a piece and of its whole.

        Parameters
        ----------
        part, whole : View
        turn : float
            1 for maps that keep the orientation of the triangles, -1 for those that reverse it, 0 to ignore it.
        """
        self.part, self.whole, self.turn = part, whole, turn
        self.looks = sample_looks(part, whole)
        rows = whole.rows[:, whole.samples]
        self.between: Floats = np.ascontiguousarray(np.minimum(rows, rows.T))
        self.courses: Directions = turned(whole.courses[whole.samples], turn)
        self.turning = TURNING if turn else 0.0

    def pairs(self, points: Indices, known: Indices) -> Pairs:
        """Return the pairs of some samples and those whose places are known."""
        return pairs_of(self.part, self.part.samples[points], known, SCALE)

    def placed(self, points: Indices, pairs: Pairs, places: Indices) -> Indices:
        """Return the best places of some samples, given the places of the known samples of `pairs`."""
        first = np.zeros(len(points), np.int64)  # any place: none is too far
        return self._assigned(points, pairs, places, first, np.inf)[0]

    def moved(self, points: Indices, pairs: Pairs, places: Indices, within: float) -> tuple[Indices, Floats]:
        """Return the best places of some samples `within` a distance of their present places, and their costs."""
        return self._assigned(points, pairs, places, places, within)

    def _assigned(
        self, points: Indices, pairs: Pairs, places: Indices, present: Indices, within: float
    ) -> tuple[Indices, Floats]:
        return assign(
            Looks(self.looks.ours[points], self.looks.theirs, self.looks.trust[points]),
            pairs,
            np.ascontiguousarray(self.between[:, places]),
            np.ascontiguousarray(self.courses[:, places]),
            present,
            present,
            self.between,
            within,
            self.turning,
        )


def turned(courses: Directions, turn: float) -> Directions:
    """Return directions, reflected if a map reverses the orientation."""
    return np.ascontiguousarray(courses.conj() if turn < 0 else courses)
