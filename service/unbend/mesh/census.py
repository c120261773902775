"""Counts of a surface's topology: boundaries, fans around vertices, orientation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from unbend.arrays import Bools, Ints
from unbend.jit import kernel
from unbend.mesh.components import join, root
from unbend.mesh.surface import Surface


@dataclass(frozen=True)
class Census:
    """Counts of a surface's topology."""

    boundary_edges: int
    boundary_loops: int
    """Loops of boundary edges, around holes or the whole surface. At each vertex a loop stays in one fan."""
    nonmanifold_edges: int
    nonmanifold_vertices: int
    """Vertices where several fans meet. A fan is a set of faces at a vertex that are connected across edges."""
    misoriented_edges: int
    """Edges of two faces with different orientations."""


def take_census(surface: Surface) -> Census:
    """Compute the `Census` of a surface, in O(m) for m faces once the edges are known."""
    # Corner 3 f + i is corner i of face f; half-edge h runs from corner next(h) to corner next(next(h)).
    vertex, twins = surface.faces.ravel(), surface.edges.twins()
    fan = np.arange(len(vertex), dtype=np.int32)
    misoriented = _join_fans(vertex, twins, fan)
    fans = np.bincount(vertex[fan == np.arange(len(fan), dtype=np.int32)])
    loops = _count_loops(twins, fan, np.zeros(len(fan), bool))
    return Census(
        boundary_edges=surface.edges.boundary,
        boundary_loops=int(loops),
        nonmanifold_edges=surface.edges.nonmanifold,
        nonmanifold_vertices=int((fans > 1).sum()),
        misoriented_edges=int(misoriented),
    )


@kernel
def _next(corner: int) -> int:
    return corner - 2 if corner % 3 == 2 else corner + 1


@kernel
def _join_fans(vertex: Ints, twins: Ints, fan: Ints) -> int:
    """Join the corners of each fan across edges; return the number of edges whose faces have opposite orientations."""
    misoriented = 0
    for half_edge in range(len(vertex)):
        twin = twins[half_edge]
        if twin < half_edge:
            continue  # on the boundary, or joined already from the other half-edge
        tail, twin_tail = _next(half_edge), _next(twin)
        head, twin_head = _next(tail), _next(twin_tail)
        if vertex[tail] == vertex[twin_tail]:
            misoriented += twins[twin] == half_edge
            join(fan, tail, twin_tail)
            join(fan, head, twin_head)
        else:
            join(fan, tail, twin_head)
            join(fan, head, twin_tail)
    return misoriented


@kernel
def _count_loops(twins: Ints, fan: Ints, seen: Bools) -> int:
    """Count the loops of boundary edges: the connected sets of fans, where boundary edges connect fans."""
    loops = 0
    for half_edge in range(len(fan)):
        if twins[half_edge] < 0:
            for corner in (_next(half_edge), _next(_next(half_edge))):
                end = root(fan, corner)
                if not seen[end]:
                    seen[end] = True
                    loops += 1
    for half_edge in range(len(fan)):
        if twins[half_edge] < 0 and join(fan, _next(half_edge), _next(_next(half_edge))):
            loops -= 1
    return loops
