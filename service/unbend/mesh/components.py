"""Connected components of a triangle list."""

from __future__ import annotations

import numpy as np

from unbend.arrays import Ints
from unbend.jit import kernel
from unbend.mesh.surface import Surface


def face_components(faces: Ints, vertex_count: int) -> tuple[int, Ints]:
    """Return the number of components and the component of each face, (m,).

    A shared vertex connects faces. Components are numbered in the order of their lowest vertices.
    """
    lowest = np.empty(len(faces), np.int32)
    _find_lowest(faces, np.arange(vertex_count, dtype=np.int32), lowest)
    present = np.zeros(vertex_count, bool)
    present[lowest] = True
    number = np.cumsum(present, dtype=np.int32)
    return int(number[-1]), number[lowest] - 1


def largest_component(surface: Surface) -> tuple[Ints, int, float]:
    """Return the faces of the component of largest area, the number of components, and that component's area share."""
    count, component = face_components(surface.faces, len(surface.vertices))
    if count == 1:
        return surface.faces, 1, 1.0
    areas = np.bincount(component, surface.face_areas, minlength=count)
    largest = int(areas.argmax())
    share = areas[largest] / areas.sum() if areas.sum() > 0 else 0.0
    return surface.faces[component == largest], count, float(share)


@kernel
def root(parent: Ints, item: int) -> int:
    """Return the lowest member of an item's set in a union-find structure, with path halving."""
    while parent[item] != item:
        parent[item] = parent[parent[item]]
        item = parent[item]
    return item


@kernel
def join(parent: Ints, a: int, b: int) -> bool:
    """Join the sets of two items; return False if both were in one set already."""
    a, b = root(parent, a), root(parent, b)
    if a == b:
        return False
    if a < b:
        parent[b] = a
    else:
        parent[a] = b
    return True


@kernel
def _find_lowest(faces: Ints, parent: Ints, lowest: Ints) -> None:
    """Find for each face the lowest vertex of its component, (m,)."""
    for face in range(len(faces)):
        join(parent, faces[face, 0], faces[face, 1])
        join(parent, faces[face, 0], faces[face, 2])
    for face in range(len(faces)):
        lowest[face] = root(parent, faces[face, 0])
