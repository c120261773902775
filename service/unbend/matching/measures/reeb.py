"""Coarse-to-fine matching of Reeb graphs (Hilaga et al. 2001)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import linear_sum_assignment

from unbend.arrays import Floats
from unbend.descriptors.reeb import LEVELS, ReebGraph
from unbend.signature.signature import Signature

_AREA_WEIGHT: Final = 0.5
"""Weight of areas. Lengths have the remaining weight (Hilaga et al., section 4)."""


@dataclass(frozen=True)
class _Node:
    """A part of the surface at one resolution, and its parts at the next finer one."""

    interval: int
    area: float
    """Share of the surface's area, divided by the number of resolutions."""
    length: float
    """Share of the total length of all nodes of this resolution, divided by the number of resolutions."""
    children: tuple[_Node, ...]


def reeb_distance(a: Signature, b: Signature) -> float:
    """Return 1 minus the similarity of two Reeb graphs, 0 to 1.

    Nodes are matched from the coarsest resolution to the finest. Children of matched nodes may match if they are in the
    same interval. Each node matches at most one other. A pair contributes the smaller of both areas and the smaller of
    both lengths (Hilaga et al., eq. 7). Hilaga et al. choose pairs greedily. Here the assignment with the greatest
    similarity is chosen, which does not depend on the order of the nodes.
    """
    return max(0.0, 1.0 - _similarity(_tree(a), _tree(b)))


def _tree(signature: Signature) -> _Node:
    """Return a root whose children are the nodes of the coarsest resolution."""
    graph = ReebGraph.unpack(signature.descriptors["reeb"])
    children: list[list[_Node]] = [[] for _ in graph.intervals]
    for level in range(LEVELS):
        lengths = graph.highs - graph.lows
        lengths = lengths / lengths.sum() if lengths.any() else graph.areas
        nodes = [
            _Node(int(interval), area / LEVELS, length / LEVELS, tuple(finer))
            for interval, area, length, finer in zip(graph.intervals, graph.areas, lengths, children, strict=True)
        ]
        if level == LEVELS - 1:
            break
        graph, parents = graph.coarser()
        children = [[] for _ in graph.intervals]
        for node, parent in zip(nodes, parents, strict=True):
            children[parent].append(node)
    return _Node(0, 0.0, 0.0, tuple(nodes))


def _similarity(a: _Node, b: _Node) -> float:
    """Return the greatest similarity of two matched nodes and their descendants."""
    own = _AREA_WEIGHT * min(a.area, b.area) + (1.0 - _AREA_WEIGHT) * min(a.length, b.length)
    return own + sum(
        _best_assignment([child for child in a.children if child.interval == interval],
                         [child for child in b.children if child.interval == interval])
        for interval in sorted({child.interval for child in a.children} & {child.interval for child in b.children})
    )  # fmt: skip


def _best_assignment(some: list[_Node], others: list[_Node]) -> float:
    similarities: Floats = np.array([[_similarity(a, b) for b in others] for a in some])
    rows, columns = linear_sum_assignment(similarities, maximize=True)
    # Sorted, so that rounding does not depend on the order of the nodes.
    return float(np.sort(similarities[rows, columns]).sum())
