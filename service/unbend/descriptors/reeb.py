"""The Reeb graph of the mean geodesic distance. Its nodes are parts of a shape (Hilaga et al. 2001)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from unbend.arrays import Floats, Indices, Ints

LEVELS: Final = 4
"""Number of resolutions: 1, 2, 4 and 8 intervals. There are too few samples for finer resolutions."""


@dataclass(frozen=True, eq=False)
class ReebGraph:
    """A graph of parts of a surface.

    A part is a connected set of points whose mean distances to all other points are in the same interval.
    """

    intervals: Indices
    """The interval of each part, (n,)."""
    areas: Floats
    """The share of the surface's area in each part, (n,)."""
    lows: Floats
    """Least height in each part, (n,): see `reeb_graph`."""
    highs: Floats
    """Greatest height in each part, (n,)."""
    edges: Indices
    """Pairs of parts that touch, (e, 2)."""

    def pack(self) -> Floats:
        """Return the graph as one vector of 2 + 4 n + 2 e numbers."""
        counts = [len(self.intervals), len(self.edges)]
        return np.concatenate([counts, self.intervals, self.areas, self.lows, self.highs, *self.edges.T]).astype(float)

    @classmethod
    def unpack(cls, vector: Floats) -> ReebGraph:
        """Return the graph of a vector from `pack`."""
        nodes, edges = vector[:2].astype(np.int64)
        intervals, areas, lows, highs, ends = np.split(vector[2:], [nodes, 2 * nodes, 3 * nodes, 4 * nodes])
        pairs: Indices = ends.reshape(2, edges).T.astype(np.int64)
        return cls(intervals.astype(np.int64), areas, lows, highs, pairs)

    def coarser(self) -> tuple[ReebGraph, Indices]:
        """Return the graph with intervals twice as long, and for each part the new part that contains it, (n,)."""
        return _merged(self.intervals // 2, self.areas, self.lows, self.highs, self.edges)


def reeb_graph(distances: Floats, faces: Ints, weights: Floats) -> ReebGraph:
    """Return the Reeb graph of a signature's samples in 2^(LEVELS - 1) intervals (Hilaga et al., "Topology matching").

    The height of a sample is its mean distance minus the least mean distance, divided by the greatest mean distance.

    Parameters
    ----------
    distances : (k, k) float64
        Geodesic distances in any unit.
    faces : (f, 3) int32
        Triangles between the samples.
    weights : (k,) float64
        Share of the area that each sample represents; they sum to 1.
    """
    mean = np.einsum("ij,j->i", distances, weights)  # not @: BLAS may divide a sum among threads
    height = (mean - mean.min()) / (mean.max() or 1.0)  # Hilaga et al., section 3.2
    count = 2 ** (LEVELS - 1)
    intervals = np.minimum((height * count).astype(np.int64), count - 1)
    sides = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    return _merged(intervals, weights, height, height, sides)[0]


def _merged(
    intervals: Indices, areas: Floats, lows: Floats, highs: Floats, edges: Indices
) -> tuple[ReebGraph, Indices]:
    """Merge parts that touch and lie in the same interval."""
    alike = edges[intervals[edges[:, 0]] == intervals[edges[:, 1]]]
    links = coo_array((np.ones(len(alike)), (alike[:, 0], alike[:, 1])), shape=(len(intervals), len(intervals)))
    count, found = connected_components(links, directed=False)
    part: Indices = found.astype(np.int64)
    shares: Floats = np.bincount(part, areas, minlength=count).astype(np.float64)
    low, high, of = np.full(count, np.inf), np.full(count, -np.inf), np.empty(count, np.int64)
    np.minimum.at(low, part, lows)
    np.maximum.at(high, part, highs)
    of[part] = intervals
    between = np.sort(part[edges], axis=1)
    touching: Indices = np.unique(between[between[:, 0] < between[:, 1]], axis=0).reshape(-1, 2).astype(np.int64)
    return ReebGraph(of, shares, low, high, touching), part
