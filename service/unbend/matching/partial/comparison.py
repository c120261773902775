"""The comparison of two surfaces in detail: which circle is where, so that geodesic distances are kept."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from unbend.arrays import Indices, Singles
from unbend.brief import brief
from unbend.jit import inlined, kernel
from unbend.local.signatures import OCTAVE, LocalSignatures
from unbend.matching.partial.profiles import Profiles, profiles_of
from unbend.matching.partial.scanning import differences, least, ordered

Relation = Literal["part", "contains", "whole"]
"""The relation of a query to a shape: a part of it, a whole that contains it, or a whole shape like it."""

ANCHORS: Final = 3
"""Circles, far from each other, that are tried as the anchor; the best one determines the places of the others."""

CANDIDATES: Final = 4
"""Places that are tried for each anchor."""

STRICTNESS: Final = 4.3
"""Penalty for a distance that differs by the square root of the smaller area, in units of the usual deviation."""

LARGEST_PENALTY: Final = np.float32(1.0)
"""Largest penalty of a distance. A worse one counts no more: a cut may have lengthened it."""

_SHARE: Final = np.float32(0.5)
"""Share of the mean penalty that is added to the mean difference: penalties of one circle depend on each other."""

_SWEEPS: Final = 2
"""Times that each circle is moved to the place that agrees best with those of all others."""

_AS_LARGE: Final = 0.95
"""A surface, query or shape, of at least this share of the other's area is no part of it: the relation is `whole`."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """The relation of a query to a shape, and how well they agree."""

    distance: float
    """Mean difference of the circles at their places, and half of the mean penalty for distances between them."""
    relation: Relation
    covered: float
    """Area of the smaller surface over that of the larger one, at most 1."""
    matched: float
    """Share of the compared circles whose places keep their distance from the anchor."""
    residual: float
    """Root of the mean squared error of these distances, in units of the query's vertices."""
    scale: float
    """Length in the shape's unit of a length 1 in the query's."""
    centre: tuple[float, float, float]
    """A point of the query, in its own coordinates, as far as possible from the boundary of the smaller surface."""
    place: tuple[float, float, float]
    """The same place on the shape, in the shape's coordinates."""
    places: Indices
    """The centre of the larger surface where each chosen circle of the smaller one is, (m,)."""

    def __repr__(self) -> str:
        return brief(
            self, self.relation, f"distance {self.distance:.3g}", f"covered {self.covered:.3g}",
            f"matched {self.matched:.3g}", f"scale {self.scale:.3g}",
        )  # fmt: skip


def compare_parts(query: LocalSignatures, shape: LocalSignatures, shift: int = 0) -> Comparison:
    """Compare two surfaces of which one may be a piece of the other.

    One circle of the smaller surface, the anchor, is put on each of the most similar places of the larger one. Then
    each other circle goes to the place that differs least, with a penalty for a wrong distance from the anchor. The
    best of all anchors and places counts. From there each circle moves to the place that differs least, with the mean
    penalty for wrong distances from all others.

    Parameters
    ----------
    query, shape : LocalSignatures
    shift : int, default 0
        Lengths of the query count 2^(shift / 4)-fold.
    """
    return compare_profiled(query, profiles_of(query), shape, profiles_of(shape), shift)


def compare_profiled(
    query: LocalSignatures, profiles: Profiles, shape: LocalSignatures, others: Profiles, shift: int
) -> Comparison:
    """Return `compare_parts` of surfaces whose profiles are known."""
    unit = float(2.0 ** (shift / OCTAVE))
    small, large, moved = ordered(profiles, others, shift)
    part, whole = (query, shape) if small is profiles else (shape, query)
    factor = unit if small is profiles else 1 / unit
    between = part.distances[np.ix_(small.chosen, small.chosen)] * np.float32(factor)
    found = differences(small, large, moved)
    comparable = np.isfinite(found).all(axis=1)  # the others have no ring in common with the larger surface's
    weights = np.where(comparable, small.weights, np.float32(0))
    found[~comparable] = 0.0
    places = np.zeros(len(small.chosen), np.int64)
    strictness = np.float32(STRICTNESS / (np.sqrt(small.area) * factor))
    anchor = _put(found, weights, between, whole.distances, _anchors(between, weights), strictness, places)
    distance = np.inf
    for _ in range(_SWEEPS if weights.any() else 0):
        distance = _moved(found, weights, between, whole.distances, strictness, places)
    errors = np.abs(whole.distances[places[anchor], places] - between[anchor])[comparable]
    kept = errors * strictness < LARGEST_PENALTY
    ratio = small.area * factor**2 / large.area
    relation: Relation = "whole"
    if small.is_open and ratio < _AS_LARGE:
        relation = "part" if small is profiles else "contains"
    points = _point(part.places[small.chosen[0]]), _point(whole.places[places[0]])
    centre, place = points if small is profiles else points[::-1]
    residual = float(np.sqrt(np.mean(errors[kept] ** 2)) if kept.any() else 0.0) / (unit if small is profiles else 1.0)
    return Comparison(
        float(distance),
        relation,
        float(min(1.0, ratio)),
        float(kept.mean() if len(kept) else 0.0),
        residual,
        unit,
        centre,
        place,
        places,
    )


def _point(coordinates: Singles) -> tuple[float, float, float]:
    x, y, z = coordinates.tolist()
    return x, y, z


def _anchors(between: Singles, weights: Singles) -> Indices:
    """Return the circle farthest from the boundary, and others that are far from it and from each other."""
    anchors = [0]
    while len(anchors) < min(ANCHORS, len(between)):
        anchors.append(int((between[anchors].min(axis=0) * weights).argmax()))
    return np.array(anchors)


@inlined
def _penalty(distance: np.float32, expected: np.float32, strictness: np.float32) -> np.float32:
    return min(abs(distance - expected) * strictness, LARGEST_PENALTY)


@kernel
def _put(
    found: Singles,
    weights: Singles,
    between: Singles,
    whole: Singles,
    anchors: Indices,
    strictness: np.float32,
    places: Indices,
) -> int:
    """Write the place of each circle by its distance from one anchor, and return the best anchor."""
    count, columns = found.shape
    best, best_anchor, best_place = np.inf, 0, 0
    values = np.empty(columns, np.float32)
    for anchor in anchors:
        order = np.argsort(found[anchor])
        for place in order[:CANDIDATES]:
            total = weights[anchor] * float(found[anchor, place])
            for row in range(count):
                if row != anchor:
                    expected = between[anchor, row]
                    for column in range(columns):
                        values[column] = found[row, column] + _penalty(whole[place, column], expected, strictness)
                    total += weights[row] * least(values)
                    if total >= best:
                        break
            if total < best:
                best, best_anchor, best_place = total, anchor, place
    for row in range(count):
        expected = between[best_anchor, row]
        for column in range(columns):
            values[column] = found[row, column] + _penalty(whole[best_place, column], expected, strictness)
        places[row] = values.argmin()
    places[best_anchor] = best_place
    return best_anchor


@kernel
def _moved(
    found: Singles, weights: Singles, between: Singles, whole: Singles, strictness: np.float32, places: Indices
) -> float:
    """Move each circle once, in place, and return the mean difference with a share of the mean penalty."""
    count, columns = found.shape
    total, total_weight = 0.0, weights.sum()
    values = np.empty(columns, np.float32)
    for row in range(count):
        values[:] = np.float32(0)
        for other in range(count):
            if other != row and weights[other] > 0:
                weight, expected, distances = weights[other], between[other, row], whole[places[other]]
                for column in range(columns):
                    values[column] += weight * _penalty(distances[column], expected, strictness)
        left = total_weight - weights[row]
        share = np.float32(1) / left if left > 0 else np.float32(0)
        for column in range(columns):
            values[column] = found[row, column] + share * values[column]
        places[row] = values.argmin()
        penalty = values[places[row]] - found[row, places[row]]
        total += weights[row] * (found[row, places[row]] + _SHARE * penalty)
    return float(total / total_weight)
