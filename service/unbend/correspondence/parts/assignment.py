"""Assignment: the place of each point that agrees best with the places of the samples."""

from __future__ import annotations

from typing import Final

import numpy as np

from unbend.arrays import Floats, Indices
from unbend.correspondence.parts.directions import Directions
from unbend.correspondence.parts.looks import LARGEST, Looks
from unbend.correspondence.parts.pairs import Pairs
from unbend.jit import kernel

STRICTNESS: Final = 3.0
"""Cost of a point whose distances are all wrong."""

TURNING: Final = 4.0
"""Cost of a point whose directions have nothing in common with those at its place."""


def assign(
    looks: Looks,
    pairs: Pairs,
    there: Floats,
    courses: Directions,
    guesses: Indices,
    present: Indices,
    away: Floats,
    within: float,
    turning: float = TURNING,
) -> tuple[Indices, Floats]:
    """Return the best of n places for each of k points, given where m samples are, and their costs, (k,) each.

    Parameters
    ----------
    looks : Looks
    pairs : Pairs
    there : (n, m) array
        Distance of each place from the place of each sample.
    courses : (n, m) array
        Direction at each place away from the place of each sample.
    guesses : (k,)
        The place that is tried first. A good one saves time.
    present, away, within : (k,), (r, n), float
        Only places are tried whose `away` in row `present` of a point is at most `within`.
    turning : float, default 4.0
        Cost of wrong directions.
    """
    places, costs = np.empty(len(present), np.int64), np.empty(len(present))
    _assign(
        looks.ours, looks.theirs, looks.trust, pairs.low, pairs.high, pairs.precision, pairs.weights, pairs.clear,
        pairs.courses, there, courses, guesses, present, away, within, STRICTNESS, turning, places, costs,
    )  # fmt: skip
    return places, costs


@kernel
def differences(ours: Floats, theirs: Floats, trust: Floats) -> Floats:
    """Return how much each point's looks differ from those of each place, (k, n)."""
    result = np.empty((len(ours), len(theirs)))
    for point in range(len(ours)):
        for place in range(len(theirs)):
            result[point, place] = _difference(ours[point], theirs[place], trust[point])
    return result


@kernel
def _difference(ours, theirs, trust):
    total = 0.0
    for feature in range(len(ours)):
        apart = ours[feature] - theirs[feature]
        total += trust[feature] * apart * apart
    return min(total, LARGEST)


@kernel
def _assign(
    ours, theirs, trust, low, high, precision, weights, clear, courses, there, their_courses,
    guesses, present, away, within, strictness, turning, places, costs,
):  # fmt: skip
    for point in range(len(ours)):
        best, at, known = np.inf, guesses[point], 0.0
        for sample in range(there.shape[1]):
            known += clear[point, sample]
        for number in range(-1, len(theirs)):
            place = guesses[point] if number < 0 else number
            if away[present[point], place] > within:
                continue
            total = _difference(ours[point], theirs[place], trust[point])
            for sample in range(there.shape[1]):
                distance = there[place, sample]
                error = max(distance - high[point, sample], low[point, sample] - distance, 0.0)
                error *= precision[point, sample]
                error *= error
                total += strictness * weights[point, sample] * error / (1.0 + error)
                if total >= best:
                    break
            if total < best and known > 0.0:
                total += turning * (1.0 - _agreement(courses[point], their_courses[place], clear[point]) / known)
            if total < best:
                best, at = total, place
        places[point], costs[point] = at, best


@kernel
def _agreement(ours, theirs, clear):
    """Return the length of the weighted sum of the turns from one direction to the other."""
    real, imaginary = 0.0, 0.0
    for sample in range(len(clear)):
        weight = clear[sample]
        if weight > 0.0:
            one, other = ours[sample], theirs[sample]
            real += weight * (one.real * other.real + one.imag * other.imag)
            imaginary += weight * (one.real * other.imag - one.imag * other.real)
    return np.sqrt(real * real + imaginary * imaginary)
