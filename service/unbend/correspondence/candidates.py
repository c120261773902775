"""Candidates: grown at the samples, judged, and the best ones grown on all vertices."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from unbend.correspondence.bivectors import BIVECTOR_FUNCTIONS, compound, directions
from unbend.correspondence.correspondence import Candidate
from unbend.correspondence.features import Features
from unbend.correspondence.growth import PointMap, embedded, grow, stretch
from unbend.correspondence.starts import candidate_maps

COARSE: Final = (9, 12, 18, 25, 35, 50)
"""Numbers of functions of the maps between samples."""

FINE: Final = (50, 70, 100)
"""Numbers of functions of the maps between all vertices."""

_STARTS: Final = 16

_SAME: Final = 1.0
"""Two candidates are the same if their images are nearer than this many sampling radii on average."""

_RIVAL: Final = 1.1
"""Largest ratio of a rival's stretch and curvature to those of the chosen candidate.

A figure that is no larger than what sampling alone causes (the two limits that follow) also passes.
"""

_SAMPLING_STRETCH: Final = 0.7  # sampling radii
_SAMPLING_CURVATURE: Final = 0.1

_APART: Final = 2.5
"""Sampling radii beyond which a candidate is a different map."""

_AGREEMENT: Final = 0.3
"""Least mean cosine between oriented planes of a map that has the wanted orientation."""


@dataclass(frozen=True, eq=False)
class Judged:
    """A map, and its figures."""

    map: PointMap
    figures: Candidate
    oriented: bool
    """Whether it has the orientation that was asked for."""

    def sort_key(self) -> tuple[bool, float]:
        """Return a key that puts the better map first."""
        return not self.oriented, self.figures.cost


def judged_candidates(a: Features, b: Features, turn: float) -> list[Judged]:
    """Return the distinct candidates between two surfaces at their samples, the best first."""
    grown = [grow(a, b, start, COARSE, turn) for start in candidate_maps(a, b, _STARTS)]
    judged = sorted((judge(a, b, found, turn) for found in grown), key=Judged.sort_key)
    distinct: list[Judged] = []
    for one in judged:
        if all(a.weights @ b.rows[one.map.to, other.map.to] > _SAME * b.radius for other in distinct):
            distinct.append(one)
    return distinct


def has_rival(figures: Sequence[Candidate], radius: float) -> bool:
    """Return whether a different map keeps distances and curvature nearly as well as the first, the chosen one."""
    chosen, *others = figures
    return any(
        other.stretch <= max(_RIVAL * chosen.stretch, _SAMPLING_STRETCH * radius)
        and other.curvature <= max(_RIVAL * chosen.curvature, _SAMPLING_CURVATURE)
        for other in others
        if other.distance > _APART * radius
    )


def refine(a: Features, b: Features, candidate: Judged, turn: float) -> Judged:
    """Grow a candidate between samples on all vertices."""
    start = PointMap(b.samples[candidate.map.to], a.samples[candidate.map.back])
    return judge(a, b, grow(a, b, start, FINE, turn), turn)


def judge(a: Features, b: Features, found: PointMap, turn: float) -> Judged:
    """Measure a map.

    Distances, functions, curvature and orientation each mistake some wrong maps, such as a body turned back to front,
    for right ones. The cost mistakes far fewer. It is the product of the first three, divided by the agreement of
    orientation if the map is oriented. The units of the figures do not change the order of the costs.
    """
    changed = float(a.weights @ stretch(a, b, found) @ b.weights)
    ours, theirs = embedded(a, b, found, COARSE[-1], turn)
    apart = float(a.weights @ ((ours[a.samples] - theirs[found.to]) ** 2).mean(axis=1))
    bent = float(a.weights @ ((a.curvatures[a.samples] - b.curvatures[found.to]) ** 2).mean(axis=1))
    agreed = _agreement(a, b, found) * (turn or 1.0)
    oriented = turn != 0 and agreed >= _AGREEMENT
    cost = changed * apart * bent / (agreed if oriented else 1.0)
    return Judged(found, Candidate(cost, changed, bent, agreed, 0.0), oriented)


def _agreement(a: Features, b: Features, found: PointMap) -> float:
    """Return the mean cosine between the oriented planes of the first functions at samples and their images."""
    size = min(a.functions.shape[1], b.functions.shape[1])
    if size < BIVECTOR_FUNCTIONS.stop:
        return 0.0
    f, g = a.functions[:, BIVECTOR_FUNCTIONS], b.functions[:, BIVECTOR_FUNCTIONS]
    carried = (f[a.samples] * a.masses[:, None]).T @ g[found.to]
    ours = directions(a.bivectors[a.samples] @ compound(carried))
    return float(a.weights @ (ours * directions(b.bivectors[found.to])).sum(axis=1))
