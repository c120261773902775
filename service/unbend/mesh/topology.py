"""Edges, neighbours across them, and connected components of a triangle list."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from unbend.arrays import Indices, Ints


@dataclass(frozen=True)
class Edges:
    """The undirected edges of a triangle list, found by sorting its half-edges once.

    Half-edge `3 f + i` lies opposite corner `i` of face `f`. `order` sorts half-edges so that those of one
    edge stand together; `starts` says where each edge begins in that order, `counts` how many faces it has.
    """

    order: Indices  # (3 m,)
    starts: Indices  # (e,)
    counts: Indices  # (e,)

    @property
    def boundary(self) -> int:
        """Number of edges with a single face."""
        return int((self.counts == 1).sum())

    @property
    def nonmanifold(self) -> int:
        """Number of edges with three faces or more."""
        return int((self.counts > 2).sum())

    def twins(self) -> Indices:
        """For each half-edge the next one of the same edge, cyclically, or -1 on the boundary, (3 m,)."""
        following = np.arange(1, len(self.order) + 1)
        last = self.starts + self.counts - 1
        following[last] = self.starts
        twins = np.empty(len(self.order), np.int64)
        twins[self.order] = self.order[following]
        twins[self.order[self.starts[self.counts == 1]]] = -1
        return twins


def find_edges(faces: Ints, vertex_count: int) -> Edges:
    """Find the edges of `faces` (m, 3)."""
    tails = faces[:, [1, 2, 0]].ravel().astype(np.int64)
    heads = faces[:, [2, 0, 1]].ravel().astype(np.int64)
    keys = np.minimum(tails, heads) * vertex_count + np.maximum(tails, heads)
    order = np.argsort(keys, kind="stable")
    keys = keys[order]
    starts = np.flatnonzero(np.concatenate([[True], keys[1:] != keys[:-1]]))
    return Edges(order, starts, np.diff(np.append(starts, len(keys))))


def face_components(faces: Ints, vertex_count: int) -> tuple[int, Ints]:
    """Return the number of components and each face's component, (m,); faces touch at a shared vertex."""
    pairs = faces[:, [0, 1]], faces[:, [1, 2]]
    rows = np.concatenate([pair[:, 0] for pair in pairs])
    columns = np.concatenate([pair[:, 1] for pair in pairs])
    graph = coo_array((np.ones(len(rows), np.int8), (rows, columns)), shape=(vertex_count, vertex_count))
    _, of_vertex = connected_components(graph, directed=False)
    used, of_face = np.unique(of_vertex[faces[:, 0]], return_inverse=True)
    return len(used), of_face.astype(np.int32)
