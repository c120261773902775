"""Places of samples of a piece among the samples of its whole."""

from __future__ import annotations

from typing import Final

import numpy as np

from unbend.arrays import Floats, Indices
from unbend.correspondence.parts.assignment import TURNING, assign
from unbend.correspondence.parts.directions import Directions
from unbend.correspondence.parts.looks import Looks, sample_looks
from unbend.correspondence.parts.pairs import pairs_of
from unbend.correspondence.parts.views import View

SCALE: Final = 0.3
"""Distance over the square root of the area at which a pair counts a third."""


class Placing:
    """What all placings of samples have in common."""

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

    def placed(
        self, points: Indices, known: Indices, places: Indices, present: Indices | None = None, within: float = np.inf
    ) -> tuple[Indices, Floats]:
        """Return the best places of some samples, and their costs, given the places of known samples.

        With the `present` places of the same samples, only places `within` a distance of them are tried.
        """
        looks = Looks(self.looks.ours[points], self.looks.theirs, self.looks.trust[points])
        samples = self.part.samples
        return assign(
            looks,
            pairs_of(self.part, samples[points], known, SCALE),
            np.ascontiguousarray(self.between[:, places]),
            np.ascontiguousarray(self.courses[:, places]),
            np.zeros(len(points), np.int64) if present is None else present,
            self.between,
            within,
            self.turning,
        )


def turned(courses: Directions, turn: float) -> Directions:
    """Return directions, reflected if a map reverses the orientation."""
    return np.ascontiguousarray(courses.conj() if turn < 0 else courses)
