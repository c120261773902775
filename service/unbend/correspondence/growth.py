"""Refinement of a map: spectral maps that grow, in both directions, with oriented planes and curvature."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from unbend.arrays import Floats, Indices, Singles
from unbend.correspondence.bivectors import BIVECTOR_FUNCTIONS, compound, directions
from unbend.correspondence.features import Features
from unbend.correspondence.nearest import nearest_rows

FUNCTION_NOISE: Final = 1.0
"""Variance that is added to the misfit of a function, so that a few smooth functions do not decide alone."""

FEATURE_NOISE: Final = 0.1
"""The same of bivectors and curvatures, which describe a point by itself."""


@dataclass(frozen=True, eq=False)
class PointMap:
    """A map between two surfaces at their samples, in both directions."""

    to: Indices  # (S_a,) a vertex of b for each sample of a
    back: Indices  # (S_b,) a vertex of a for each sample of b


def grow(a: Features, b: Features, start: PointMap, sizes: Sequence[int], turn: float) -> PointMap:
    """Refine a map with more and more functions.

    ZoomOut (Melzi et al. 2019) in both directions (Ren et al. 2020, "MapTree"): the map gives the matrix that carries
    the first k functions of one surface to the other, and the nearest points in these functions give the next map.
    Oriented planes and curvatures are further coordinates of the points.

    Parameters
    ----------
    a, b : Features
    start : PointMap
    sizes : sequence of int
        The numbers of functions.
    turn : float
        1 for maps that keep the orientation, -1 for those that reverse it, 0 to ignore it.
    """
    current = start
    for size in sizes:
        ours, theirs = embedded(a, b, current, size, turn)
        current = PointMap(nearest_rows(ours[a.samples], theirs), nearest_rows(theirs[b.samples], ours))
    return current


def embedded(a: Features, b: Features, known: PointMap, size: int, turn: float) -> tuple[Singles, Singles]:
    """Return coordinates of all vertices of both surfaces in which points that `known` maps are near, (n, d) each.

    Each coordinate is divided by the standard deviation of its misfit under `known`, so that a coordinate counts as far
    as the surfaces agree in it.
    """
    size = min(size, a.functions.shape[1], b.functions.shape[1])
    f, g = a.functions[:, :size], b.functions[:, :size]
    carried = ((f[a.samples] * a.masses[:, None]).T @ g[known.to]).astype(np.float32)
    returned = ((g[b.samples] * b.masses[:, None]).T @ f[known.back]).astype(np.float32)
    blocks = [(f @ carried, g, FUNCTION_NOISE), (f, g @ returned, FUNCTION_NOISE)]
    blocks += [(a.curvatures, b.curvatures, FEATURE_NOISE)]
    if turn and size >= BIVECTOR_FUNCTIONS.stop:  # a mesh of a few vertices has fewer functions
        smooth, planes, others = BIVECTOR_FUNCTIONS, a.bivectors, np.float32(turn) * b.bivectors
        blocks += [
            (directions(planes @ compound(carried[smooth, smooth])), directions(others), FEATURE_NOISE),
            (directions(planes), directions(others @ compound(returned[smooth, smooth])), FEATURE_NOISE),
        ]
    ours, theirs = [], []
    for one, other, noise in blocks:
        scale = np.float32(1) / np.sqrt(_misfit(a, b, known, one, other) + np.float32(noise))
        ours.append(one * scale)
        theirs.append(other * scale)
    return np.hstack(ours), np.hstack(theirs)


def _misfit(a: Features, b: Features, known: PointMap, one: Singles, other: Singles) -> Singles:
    """Return the mean squared difference of each column between points that are mapped to each other."""
    forth = a.weights @ (one[a.samples] - other[known.to]) ** 2
    return np.asarray((forth + b.weights @ (other[b.samples] - one[known.back]) ** 2) / 2, np.float32)


def stretch(a: Features, b: Features, known: PointMap) -> Floats:
    """Return for each pair (sample of a, sample of b) how much the map changes their distance, (S_a, S_b).

    The distance from p to the preimage of q on one surface, and from the image of p to q on the other, are both known,
    because one end is a sample.
    """
    return np.abs(a.rows[:, known.back].astype(np.float64) - b.rows[:, known.to].T)
