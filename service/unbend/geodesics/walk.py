"""One order of a surface's faces, however its file writes them.

What marching finds depends a little on the order of visits, for the update equations have more than one fixed point.
So the order must not be the file's. We walk over the faces from one that lengths alone choose, and turn each as we
enter it. The walk is the same when faces are listed in another order, begin at another corner, or face the other way.
Where three or more faces meet at an edge, lengths order them, too. Among equals labels of vertices choose.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from unbend.arrays import Bools, Floats, Ints
from unbend.jit import kernel

_GRADES: Final = 2.0**30
"""Lengths up to the longest are told apart in so many grades: rounding must not choose among equals."""


def walk_faces(faces: Ints, twins: Ints, lengths: Floats) -> tuple[Ints, Bools]:
    """Return the order of a walk over faces (m, 3): breadth first, over edges of two faces.

    It begins at the face with the longest circumference, and so does the walk over each part that is left.

    Parameters
    ----------
    faces : (m, 3) int32
    twins : (3 m,) int32
        As `unbend.mesh.topology` has them.
    lengths : (3 m,) float64
        Of half-edges.

    Returns
    -------
    entries : (m,) int32
        The half-edge over which the walk enters each face, in the order of the walk.
    turned : (m,) bool
        Whether that face is to be turned around, so that it agrees with the face before it.
    """
    grades = _graded(lengths)
    around = grades.sum(axis=1)
    entries, turned = np.empty(len(faces), np.int32), np.empty(len(faces), np.bool_)
    seen = np.zeros(len(faces), np.bool_)
    longest = _sorted(np.flatnonzero(around == around.max()), faces, around)[:1]
    size = _walk(faces, twins, grades, longest, entries, turned, seen, 0)
    if size < len(faces):
        _walk(faces, twins, grades, _sorted(np.flatnonzero(~seen), faces, around), entries, turned, seen, size)
    return entries, turned


def sort_rings(faces: Ints, twins: Ints, lengths: Floats) -> Ints:
    """Return twins, (3 m,), that go around an edge of several faces from the shortest circumference to the longest."""
    sorted_twins: Ints = _sort_rings(faces, twins, _graded(lengths).sum(axis=1))
    return sorted_twins


def _graded(lengths: Floats) -> NDArray[np.int64]:
    grades: NDArray[np.int64] = np.rint(lengths.reshape(-1, 3) * (_GRADES / (lengths.max() or 1.0))).astype(np.int64)
    return grades


def _sorted(chosen: NDArray[np.intp], faces: Ints, around: NDArray[np.int64]) -> NDArray[np.intp]:
    """Sort faces, the longest circumference first, then by their vertices."""
    first, second, third = np.sort(faces[chosen], axis=1).T
    return chosen[np.lexsort((third, second, first, -around[chosen]))]


@kernel
def _sort_rings(faces, twins, around):
    result, seen, ring = twins.copy(), np.zeros(len(twins), np.bool_), np.empty(len(twins), np.int32)
    for half_edge in range(len(twins)):
        size, at = 0, half_edge
        while at >= 0 and not seen[at]:
            seen[at] = True
            ring[size] = at
            at, size = twins[at], size + 1
        if size < 3:
            continue
        here = ring[:size]
        here[:] = here[np.argsort(np.array([faces[side // 3, side % 3] for side in here]), kind="mergesort")]
        here[:] = here[np.argsort(np.array([around[side // 3] for side in here]), kind="mergesort")]
        for place in range(size):
            result[here[place]] = here[(place + 1) % size]
    return result


@kernel
def _walk(faces, twins, grades, seeds, entries, turned, seen, size):
    """Walk from each seed not seen yet; return how many faces were entered in all."""
    for seed in seeds:
        if seen[seed]:
            continue
        seen[seed] = True
        corner, after = _two_corners(faces[seed], grades[seed])
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
def _two_corners(face, grades):
    """Return the corner opposite the longest side, and that opposite the next."""
    first = 0
    for i in range(1, 3):
        if _precedes(face, grades, i, first):
            first = i
    second, third = (first + 1) % 3, (first + 2) % 3
    return first, third if _precedes(face, grades, third, second) else second


@kernel
def _precedes(face, grades, i, j):
    return grades[i] > grades[j] or (grades[i] == grades[j] and face[i] < face[j])
