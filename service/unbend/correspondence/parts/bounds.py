"""How long the distances within a piece can be in its whole."""

from __future__ import annotations

from typing import Final

import numpy as np

from unbend.arrays import Floats, Indices
from unbend.jit import kernel
from unbend.mesh.smooth import boundary_edges
from unbend.mesh.surface import Surface

_CROSSINGS: Final = 120
"""Most points of the boundary at which a shorter path may leave the piece."""


def crossings(surface: Surface) -> Indices:
    """Return up to 120 vertices spread over the boundary of a surface."""
    rim = np.unique(boundary_edges(surface))
    order = np.argsort(surface.vertices[rim].sum(axis=1), kind="stable")
    steps = np.linspace(0, len(rim) - 1, min(len(rim), _CROSSINGS)).round().astype(np.int64)
    return np.asarray(rim[order][steps])


def least_distances(ours: Floats, theirs: Floats, between: Floats, within: Floats) -> Floats:
    """Return the least distance that each pair of points of a piece can have in its whole, (k, m).

    A path of the whole that is shorter than all paths of the piece leaves the piece at a point of the boundary, and
    returns at another. Outside, it is at least as long as the straight line between them.

    Parameters
    ----------
    ours : (k, c) float64
        Distances within the piece from k points to points of the boundary.
    theirs : (m, c) float64
        The same from m points.
    between : (c, c) float64
        Straight distances between the points of the boundary.
    within : (k, m) float64
        Distances within the piece.
    """
    least = within.copy()
    _shorten(ours, theirs, between, np.empty(ours.shape[1]), least)
    return least


@kernel
def _shorten(ours: Floats, theirs: Floats, between: Floats, crossed: Floats, least: Floats) -> None:
    """Lower `least` to the shortest path over two points of the boundary."""
    for row in range(len(ours)):
        crossed[:] = ours[row]
        for at in range(len(between)):
            for other in range(len(between)):
                crossed[other] = min(crossed[other], ours[row, at] + between[at, other])
        for column in range(len(theirs)):
            best = least[row, column]
            for at in range(len(between)):
                best = min(best, crossed[at] + theirs[column, at])
            least[row, column] = best
