"""A canonical order of a surface's faces, independent of the order in its file.

The distances of marching depend slightly on the order of visits, because the update equations have more than one fixed
point. So the order must not come from the file. The walk starts at a face chosen by its lengths, and orients each face
like the face from which it enters. The walk stays the same if the file lists faces in another order, starts them at
another corner, or reverses their orientation. Lengths also order the faces at an edge of three or more. Vertex numbers
break ties.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from unbend.arrays import Bools, Floats, Ints
from unbend.jit import kernel

_LEVELS: Final = 2.0**30
"""The longest length in rounded units. Lengths are rounded to whole units, so that rounding errors break no ties."""


def walk_faces(faces: Ints, twins: Ints, lengths: Floats) -> tuple[Ints, Bools]:
    """Return the order of a breadth-first walk over faces (m, 3), across edges of exactly two faces.

    The walk starts at the face with the longest perimeter. When it can reach no further face, it continues at the
    remaining face with the longest perimeter.

    Parameters
    ----------
    faces : (m, 3) int32
    twins : (3 m,) int32
        See `unbend.mesh.topology`.
    lengths : (3 m,) float64
        Lengths of half-edges.

    Returns
    -------
    entries : (m,) int32
        The half-edge over which the walk enters each face, in the order of the walk. For a face at which the walk
        starts, its longest half-edge.
    turned : (m,) bool
        Whether the walk reverses the orientation of that face, so that it agrees with the orientation that the walk
        gave the face from which it came. A face at which the walk starts is oriented so that its
        second longest side follows its longest.
    """
    levels = _quantized(lengths)
    perimeters = levels.sum(axis=1)
    entries, turned = np.empty(len(faces), np.int32), np.empty(len(faces), np.bool_)
    seen = np.zeros(len(faces), np.bool_)
    longest = _sorted(np.flatnonzero(perimeters == perimeters.max()), faces, perimeters)[:1]
    size = _walk(faces, twins, levels, longest, entries, turned, seen, 0)
    if size < len(faces):
        _walk(faces, twins, levels, _sorted(np.flatnonzero(~seen), faces, perimeters), entries, turned, seen, size)
    return entries, turned


def sort_cycles(faces: Ints, twins: Ints, lengths: Floats) -> Ints:
    """Return `twins` (3 m,) with each cycle of three half-edges or more sorted by the perimeters of the faces."""
    sorted_twins: Ints = _sort_cycles(faces, twins, _quantized(lengths).sum(axis=1))
    return sorted_twins


def _quantized(lengths: Floats) -> NDArray[np.int64]:
    levels: NDArray[np.int64] = np.rint(lengths.reshape(-1, 3) * (_LEVELS / (lengths.max() or 1.0))).astype(np.int64)
    return levels


def _sorted(chosen: NDArray[np.intp], faces: Ints, perimeters: NDArray[np.int64]) -> NDArray[np.intp]:
    """Sort faces, the longest perimeter first, then by their vertices."""
    first, second, third = np.sort(faces[chosen], axis=1).T
    return chosen[np.lexsort((third, second, first, -perimeters[chosen]))]


@kernel
def _sort_cycles(faces, twins, perimeters):
    result, seen, cycle = twins.copy(), np.zeros(len(twins), np.bool_), np.empty(len(twins), np.int32)
    for half_edge in range(len(twins)):
        size, at = 0, half_edge
        while at >= 0 and not seen[at]:
            seen[at] = True
            cycle[size] = at
            at, size = twins[at], size + 1
        if size < 3:
            continue
        here = cycle[:size]
        here[:] = here[np.argsort(np.array([faces[side // 3, side % 3] for side in here]), kind="mergesort")]
        here[:] = here[np.argsort(np.array([perimeters[side // 3] for side in here]), kind="mergesort")]
        for place in range(size):
            result[here[place]] = here[(place + 1) % size]
    return result


@kernel
def _walk(faces, twins, levels, seeds, entries, turned, seen, size):
    """Walk from each of `seeds` that is not in `seen` yet; return the total number of faces entered."""
    for seed in seeds:
        if seen[seed]:
            continue
        seen[seed] = True
        corner, after = _two_corners(faces[seed], levels[seed])
        entries[size], turned[size] = 3 * seed + corner, after != (corner + 1) % 3
        head = size
        size += 1
        while head < size:
            face, i = entries[head] // 3, entries[head] % 3
            for step in range(3):
                j = (i - step) % 3 if turned[head] else (i + step) % 3
                side = 3 * face + j
                twin = twins[side]
                if twin < 0 or twins[twin] != side or seen[twin // 3]:
                    continue
                other = twin // 3
                seen[other] = True
                agree = faces[face, (j + 1) % 3] == faces[other, (twin + 2) % 3]
                entries[size], turned[size] = twin, turned[head] == agree
                size += 1
            head += 1
    return size


@kernel
def _two_corners(face, levels):
    """Return the corner opposite the longest side and the corner opposite the second longest."""
    first = 0
    for i in range(1, 3):
        if _precedes(face, levels, i, first):
            first = i
    second, third = (first + 1) % 3, (first + 2) % 3
    return first, third if _precedes(face, levels, third, second) else second


@kernel
def _precedes(face, levels, i, j):
    return levels[i] > levels[j] or (levels[i] == levels[j] and face[i] < face[j])
