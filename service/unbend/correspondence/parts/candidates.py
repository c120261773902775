"""Candidates: arrangements of all samples of a piece on its whole, the best first."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from unbend.arrays import Floats, Indices
from unbend.correspondence.parts.assignment import STRICTNESS, differences
from unbend.correspondence.parts.judgement import Judgement, Map, judge
from unbend.correspondence.parts.looks import rings_differ
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
_GUESSED: Final = 24  # arrangements in which they are placed to find the scale
_KEPT: Final = 24  # arrangements, the best, that are kept after the first move
_COARSE: Final = 60  # samples, the first ones, that are placed in these arrangements
_FINE: Final = 8  # candidates in which all samples are placed
_SAME: Final = 0.05  # candidates that differ less are one
_MOVES: Final = (0.4, 0.3)  # how far the first samples, and later all samples, may move at a time

_DEEP: Final = (0.5, 0.15)
"""Distance from the boundary that is enough for the first anchor, and for the others."""


@dataclass(frozen=True, eq=False)
class Placed:
    """The place of each sample of a piece among the samples of its whole, and how good they are."""

    places: Indices
    judgement: Judgement


def placings(part: View, whole: View, turns: tuple[float, ...]) -> list[Placed]:
    """Return the candidates of all `turns` in one list, the best first."""
    found = []
    for turn in turns:
        placing = Placing(part, whole, turn)
        every = np.arange(len(part.samples))
        pairs = placing.pairs(every, every)
        found += [_judged(placing, pairs, _settled(placing, pairs, places)) for places in _coarse(placing, _TRIED)]
    return sorted(found, key=lambda each: each.judgement.sort_key())


def size_ratio(part: View, whole: View, turn: float) -> float:
    """Return distances on the whole over those on the piece, in the best arrangement of the first samples."""
    placing = Placing(part, whole, turn)
    places = _coarse(placing, _GUESSED)[0]
    some = np.arange(len(places))
    pairs = placing.pairs(some, some)
    return _ratio(pairs.low, pairs.high, placing.between[np.ix_(places, places)])


def _coarse(placing: Placing, tried: int) -> list[Indices]:
    """Return places of the first samples in the best arrangements, which differ before their last move; best first."""
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
    there, courses = placing.between[np.ix_(places, places)], placing.courses[np.ix_(places, places)]
    rings = rings_differ(placing.looks, places)
    found = Map(placing.whole.samples[places], there, courses, rings, placing.turn)
    return Placed(places, judge(placing.part, placing.whole, pairs, found))


def _ratio(low: Floats, high: Floats, there: Floats) -> float:
    """Return the median ratio of the distances that are certain."""
    certain = (high > 0.1) & (high - low < 0.02)
    if not certain.any():
        return 1.0
    return float(np.exp(np.median(np.log(np.maximum(there[certain], 0.02) / high[certain]))))
