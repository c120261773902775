"""Pairs of points and samples of a piece: the distances and directions between them, and how far each is certain."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from unbend.arrays import Floats, Indices
from unbend.correspondence.parts.directions import Directions
from unbend.correspondence.parts.views import View

ERROR: Final = (0.03, 0.08)
"""Usual error of a distance between two poses: a constant, and a share of the distance."""

_NEAR: Final = 0.05
"""Distance below which a direction is not clear."""

_DOUBT: Final = 0.03
"""Width of the interval of a distance at which its direction counts half: another path may be the shortest one."""


@dataclass(frozen=True, eq=False)
class Pairs:
    """Pairs of k points and m samples of a piece, (k, m) each."""

    low: Floats
    high: Floats
    """The interval of the distance in the whole."""
    precision: Floats
    """One over the usual error of the distance."""
    weights: Floats
    """Weights of distances, with the sum 1 for each point."""
    clear: Floats
    """Weights of directions."""
    courses: Directions
    """Direction at the point away from the sample."""


def pairs_of(view: View, points: Indices, samples: Indices, scale: float) -> Pairs:
    """Return the pairs of vertices `points` and samples number `samples`; weights fall as exp(-distance / `scale`)."""
    grid = np.ix_(samples, points)
    high, low = np.ascontiguousarray(view.rows[grid].T), np.ascontiguousarray(view.least[grid].T)
    weights = view.weights[samples] * np.exp(-high / scale)
    weights /= weights.sum(axis=1, keepdims=True)
    clear = weights * (high > _NEAR) / (1.0 + ((high - low) / _DOUBT) ** 2)
    courses = np.ascontiguousarray(view.courses[np.ix_(points, samples)])
    return Pairs(low, high, 1.0 / (ERROR[0] + ERROR[1] * high), weights, clear, courses)
