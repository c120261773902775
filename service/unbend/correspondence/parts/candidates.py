"""Candidates: arrangements of all samples of a piece on its whole, and the figures that judge them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from unbend.arrays import Floats, Indices
from unbend.correspondence.correspondence import Candidate
from unbend.correspondence.parts.assignment import STRICTNESS, differences
from unbend.correspondence.parts.looks import looks_differ
from unbend.correspondence.parts.orientation import agreement
from unbend.correspondence.parts.pairs import Pairs
from unbend.correspondence.parts.placing import Placing
from unbend.correspondence.parts.search import arrangements
from unbend.correspondence.parts.views import View

_ANCHORS: Final = 16  # samples that are placed first
_WIDTH: Final = 128  # arrangements that are continued
_BRANCHES: Final = 4  # places at which each is continued
_APART: Final = 0.12  # least distance between these places
_ALIKE: Final = 0.1  # arrangements that differ less are one

_TRIED: Final = 64  # arrangements in which more samples are placed
_GUESSED: Final = 24  # the same, to find the scale
_KEPT: Final = 24  # the best of them
_COARSE: Final = 60  # these samples
_FINE: Final = 8  # candidates in which all samples are placed
_SAME: Final = 0.05  # candidates that differ less are one
_MOVES: Final = (0.4, 0.3)  # how far coarse and fine samples move at a time

_DEEP: Final = (0.5, 0.15)
"""Distance from the boundary that is enough for the first anchor, and for the others."""

_LEAST_AGREEMENT: Final = 0.2
"""Least agreement of triangles in a map that has the wanted orientation."""

_SOME: Final = 0.2
"""Added to the difference of circles: a piece that is narrow everywhere has hardly any."""


@dataclass(frozen=True, eq=False)
class Placed:
    """The place of each sample of a piece among the samples of its whole, and the figures."""

    places: Indices
    figures: Candidate
    turn: float
    oriented: bool
    """Whether it has the orientation that was asked for."""

    def sort_key(self) -> tuple[bool, float]:
        """Return a key that puts the better map first."""
        return self.turn != 0 and not self.oriented, self.figures.cost


def placings(part: View, whole: View, turns: tuple[float, ...]) -> list[Placed]:
    """Return the distinct candidates for each of `turns`, the best first."""
    found = []
    for turn in turns:
        placing = Placing(part, whole, turn)
        every = np.arange(len(part.samples))
        pairs = placing.pairs(every, every)
        found += [_judged(placing, pairs, _settled(placing, pairs, places)) for places in _coarse(placing, _TRIED)]
    return sorted(found, key=Placed.sort_key)


def size_ratio(part: View, whole: View, turn: float) -> float:
    """Return distances on the whole over those on the piece, in the best arrangement of the first samples."""
    placing = Placing(part, whole, turn)
    places = _coarse(placing, _GUESSED)[0]
    some = np.arange(len(places))
    pairs = placing.pairs(some, some)
    return _ratio(pairs.low, pairs.high, placing.between[np.ix_(places, places)])


def _coarse(placing: Placing, tried: int) -> list[Indices]:
    """Return places of the first samples in the best distinct arrangements, the best first."""
    anchors = _anchors(placing.part)
    some = np.arange(min(_COARSE, len(placing.part.samples)))
    to_anchors, pairs = placing.pairs(some, anchors), placing.pairs(some, some)
    weights = placing.part.weights[some]
    found = [placing.placed(some, to_anchors, state) for state in _arrangements(placing, anchors)[:tried]]
    for kept in (_KEPT, _FINE):
        moved = [placing.moved(some, pairs, places, _MOVES[0]) for places in _distinct(placing, found)]
        found = [places for places, _ in sorted(moved, key=lambda each: float(weights @ each[1]))][:kept]
    return found


def _distinct(placing: Placing, found: list[Indices]) -> list[Indices]:
    """Return the placings of the first samples that differ from all before them."""
    distinct: list[Indices] = []
    for places in found:
        if all(placing.between[places, other].mean() > _SAME for other in distinct):
            distinct.append(places)
    return distinct


def _settled(placing: Placing, pairs: Pairs, coarse: Indices) -> Indices:
    """Return places of all samples, given those of the first ones."""
    some, every = np.arange(len(coarse)), np.arange(len(placing.part.samples))
    places = placing.placed(every, placing.pairs(every, some), coarse)
    for _ in range(2):
        places, _ = placing.moved(every, pairs, places, _MOVES[1])
    return places


def _anchors(part: View) -> Indices:
    """Return samples far from each other and from the boundary, the farthest from the boundary first."""
    between, reach = part.rows[:, part.samples], part.reach[part.samples]
    anchors = [int(np.minimum(reach, _DEEP[0]).argmax())]
    depth = np.minimum(reach, _DEEP[1]) + _DEEP[1] / 3
    while len(anchors) < min(_ANCHORS, len(reach)):
        anchors.append(int((between[anchors].min(axis=0) * depth).argmax()))
    return np.array(anchors)


def _arrangements(placing: Placing, anchors: Indices) -> Indices:
    looks = placing.looks
    pairs = placing.pairs(anchors, anchors)
    return np.asarray(
        arrangements(
            differences(looks.ours[anchors], looks.theirs, looks.trust[anchors]),
            pairs.low,
            pairs.high,
            pairs.precision,
            pairs.clear / pairs.weights,
            pairs.courses,
            placing.between,
            placing.courses,
            (_WIDTH, _BRANCHES),
            STRICTNESS,
            placing.turning,
            _APART,
            _ALIKE,
        )
    )


def _judged(placing: Placing, pairs: Pairs, places: Indices) -> Placed:
    """Measure a map. No figure tells right maps from wrong ones alone; their product, without units, does."""
    part, whole = placing.part, placing.whole
    there = placing.between[np.ix_(places, places)]
    errors = np.maximum(np.maximum(there - pairs.high, pairs.low - there), 0.0)
    squared = (errors * pairs.precision) ** 2
    strain = float(part.weights @ (pairs.weights * squared / (1.0 + squared)).sum(axis=1))
    sums = np.abs((pairs.clear * placing.courses[np.ix_(places, places)] * pairs.courses.conj()).sum(axis=1))
    turned = float(part.weights @ (1.0 - sums / np.maximum(pairs.clear.sum(axis=1), np.finfo(np.float64).tiny)))
    rings, curved = (float(part.weights @ each) for each in looks_differ(placing.looks, places))
    agreed = agreement(part, whole, whole.samples[places]) * (placing.turn or 1.0)
    stretch = float(part.weights @ (pairs.weights * errors).sum(axis=1))
    cost = strain * (turned if placing.turn else 1.0) * curved * (rings + _SOME)
    figures = Candidate(cost, stretch, _curvature(part, whole, places), agreed, 0.0)
    oriented = placing.turn != 0 and agreed >= _LEAST_AGREEMENT
    return Placed(places, figures, placing.turn, oriented)


def _curvature(part: View, whole: View, places: Indices) -> float:
    apart = part.curvatures[part.samples] - whole.curvatures[whole.samples[places]]
    return float(part.weights @ (apart**2).mean(axis=1))


def _ratio(low: Floats, high: Floats, there: Floats) -> float:
    """Return the median ratio of the distances that are certain."""
    certain = (high > 0.1) & (high - low < 0.02)
    if not certain.any():
        return 1.0
    return float(np.exp(np.median(np.log(np.maximum(there[certain], 0.02) / high[certain]))))
