"""Links that connect the components of a mesh."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from unbend.arrays import Floats, Indices, Ints
from unbend.jit import kernel
from unbend.mesh.areas import triangle_areas
from unbend.mesh.boxes import LEAF, box_distance, build_boxes, push_children, uniform_labels
from unbend.mesh.components import face_components, join, root
from unbend.mesh.surface import Surface

_MOST_NEIGHBOURS: Final = 128  # largest number of neighbours of a link's end that are tried as a third corner


@dataclass(frozen=True, eq=False)
class Bridges:
    """Faces that connect the components of a surface."""

    faces: Ints  # (count - 1, 3); the first two corners are the link's ends
    lengths: Floats  # (count - 1,)
    area: float
    """Total area of the added faces."""


def bridge(surface: Surface) -> Bridges:
    """Connect the components of `surface` by the shortest links between their vertices.

    The links are a minimum spanning tree of the components. Each link is an edge of a new triangle, whose third corner
    is the neighbour of one of the link's ends that gives the least area. No vertex is added.
    """
    count, component = face_components(surface.faces, len(surface.vertices))
    labels = np.empty(len(surface.vertices), np.int32)
    labels[surface.faces] = component[:, None]
    used = surface.used_vertices
    scale = surface.extent or 1.0
    points = (surface.vertices[used] - surface.vertices[used[0]]) / scale
    pairs = shortest_links(points, labels[used], count)
    lengths = scale * np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1)
    faces, areas = _thinnest_faces(surface, used[pairs])
    return Bridges(faces, lengths, float(areas.sum()))


def shortest_links(points: Floats, labels: Ints, count: int) -> Indices:
    """Return pairs of `points` (n, 3) that join `count` sets, labelled 0 .. count - 1, into one set, (count - 1, 2).

    The pairs are a minimum spanning tree (Borůvka). In each round every set except the largest takes its shortest link
    to another set, which about halves the number of sets.
    """
    tree = build_boxes(points, points)
    ordered, labels = points[tree.order], labels[tree.order]
    links: list[Indices] = []
    while count > 1:
        largest = int(np.bincount(labels).argmax())
        found = _shortest_outgoing(
            ordered, labels, tree.lower, tree.upper, uniform_labels(tree, labels), count, largest
        )
        taken, merged = _merge(labels[found], largest)
        links.append(found[taken])
        labels = merged[labels]
        count -= len(taken)
    return tree.order[np.concatenate(links)] if links else np.empty((0, 2), np.int64)


@kernel
def _shortest_outgoing(
    points: Floats, labels: Ints, lower: Floats, upper: Floats, uniform: Ints, count: int, largest: int
) -> Indices:
    """Return for each set except `largest` its nearest pair (own point, point of another set), (count, 2)."""
    best = np.full(count, np.inf)
    pairs = np.zeros((count, 2), np.int64)
    stack = np.empty(64, np.int64)
    leaves = len(lower) // 2
    for i in range(len(points)):
        own = labels[i]
        if own == largest:
            continue
        x, y, z = points[i]
        stack[0], top = 1, 0
        while top >= 0:
            node = stack[top]
            top -= 1
            if uniform[node] == own or box_distance(lower, upper, node, x, y, z) >= best[own]:
                continue
            if node < leaves:
                top = push_children(stack, top, node, lower, upper, x, y, z)
                continue
            for j in range(LEAF * (node - leaves), min(LEAF * (node - leaves + 1), len(points))):
                if labels[j] != own:
                    distance = (x - points[j, 0]) ** 2 + (y - points[j, 1]) ** 2 + (z - points[j, 2]) ** 2
                    if distance < best[own]:
                        best[own] = distance
                        pairs[own, 0], pairs[own, 1] = i, j
    return pairs


def _merge(ends: Ints, largest: int) -> tuple[Indices, Ints]:
    """Join sets by links from `ends[:, 0]` to `ends[:, 1]`; return the links that joined two sets, and new labels.

    Some links join nothing: two sets may choose the same link, and links of equal length may close a cycle.
    """
    sets = np.arange(len(ends), dtype=np.int32)
    taken = [label for label in range(len(ends)) if label != largest and join(sets, ends[label, 0], ends[label, 1])]
    roots = np.array([root(sets, label) for label in range(len(ends))])
    return np.array(taken, np.int64), np.unique(roots, return_inverse=True)[1].astype(np.int32)


def _thinnest_faces(surface: Surface, links: Indices) -> tuple[Ints, Floats]:
    """Return for each link its face of least area with a neighbour of either end, and that area."""
    ends, others = links.ravel(), links[:, ::-1].ravel()
    neighbours, starts, counts = _neighbours(surface.faces, len(surface.vertices), ends)
    end = np.repeat(np.arange(len(ends)), counts)
    third = neighbours[starts[end] + np.arange(len(end)) - np.repeat(np.cumsum(counts) - counts, counts)]
    faces = np.stack([ends[end], others[end], third], axis=1).astype(np.int32)
    areas = triangle_areas(surface.vertices, faces, surface.scale)
    order = np.lexsort((areas, end // 2))
    thinnest = order[np.searchsorted(end[order] // 2, np.arange(len(links)))]
    return faces[thinnest], areas[thinnest]


def _neighbours(faces: Ints, vertex_count: int, ends: Indices) -> tuple[Indices, Indices, Indices]:
    """Return an array of neighbours, and for each of `ends` the start and the number of its neighbours there."""
    wanted = np.zeros(vertex_count, bool)
    wanted[ends] = True
    near = faces[wanted[faces].any(axis=1)].astype(np.int64)
    pairs = np.concatenate([near[:, [i, j]] for i in range(3) for j in range(3) if i != j])
    pairs = pairs[wanted[pairs[:, 0]]]
    pairs = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
    starts = np.searchsorted(pairs[:, 0], ends)
    counts = np.searchsorted(pairs[:, 0], ends, side="right") - starts
    return pairs[:, 1], starts, np.minimum(counts, _MOST_NEIGHBOURS)
