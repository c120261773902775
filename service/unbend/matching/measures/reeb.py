"""Matching of Reeb graphs, from coarse to fine."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import linear_sum_assignment

from unbend.arrays import Floats
from unbend.descriptors.reeb import LEVELS, ReebGraph
from unbend.matching.measures.protocol import PairMeasure
from unbend.signature.signature import Signature

_AREA: Final = 0.5
"""Weight of areas beside lengths: Hilaga et al., section 4."""


@dataclass(frozen=True)
class _Part:
    """A part at one resolution, and what it falls into at the next."""

    interval: int
    area: float
    """Share of the surface, over the number of resolutions."""
    length: float
    """Share of the lengths of all parts of this resolution, over the number of resolutions."""
    parts: tuple[_Part, ...]


def reeb_distance(a: Signature, b: Signature) -> float:
    """Return 1 minus the similarity of two Reeb graphs, 0 to 1.

    Parts are matched from the whole surface on: parts of matched parts, in the same interval, each with at most one.
    A pair adds the smaller of both areas and of both lengths (Hilaga et al., eq. 7). Where they choose pairs greedily,
    this takes the pairs that give the greatest similarity, which is defined whatever the order of parts.
    """
    return max(0.0, 1.0 - _similarity(_whole(a), _whole(b)))


def _whole(signature: Signature) -> _Part:
    graph = ReebGraph.unpack(signature.descriptors["reeb"])
    below: list[list[_Part]] = [[] for _ in graph.intervals]
    for level in range(LEVELS):
        lengths = graph.highs - graph.lows
        lengths = lengths / lengths.sum() if lengths.any() else graph.areas
        parts = [
            _Part(int(interval), area / LEVELS, length / LEVELS, tuple(of))
            for interval, area, length, of in zip(graph.intervals, graph.areas, lengths, below, strict=True)
        ]
        if level == LEVELS - 1:
            break
        graph, within = graph.coarser()
        below = [[] for _ in graph.intervals]
        for part, place in zip(parts, within, strict=True):
            below[place].append(part)
    return _Part(0, 0.0, 0.0, tuple(parts))


def _similarity(one: _Part, other: _Part) -> float:
    """Return the greatest similarity of two parts and of what they fall into."""
    own = _AREA * min(one.area, other.area) + (1.0 - _AREA) * min(one.length, other.length)
    return own + sum(
        _best_pairs([part for part in one.parts if part.interval == interval],
                    [part for part in other.parts if part.interval == interval])
        for interval in sorted({part.interval for part in one.parts} & {part.interval for part in other.parts})
    )  # fmt: skip


def _best_pairs(some: list[_Part], others: list[_Part]) -> float:
    similarities: Floats = np.array([[_similarity(one, other) for other in others] for one in some])
    rows, columns = linear_sum_assignment(similarities, maximize=True)
    return float(np.sort(similarities[rows, columns]).sum())


REEB: Final = PairMeasure(
    name="reeb",
    invariances=("bending", "rotation", "reflection", "scale"),
    reference="Hilaga et al. 2001: Reeb graphs of the mean geodesic distance, of parts in 1, 2, 4 and 8 intervals",
    cost="a millisecond: an assignment of parts",
    distance=reeb_distance,
)
