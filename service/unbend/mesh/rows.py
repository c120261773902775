"""Equal rows of large arrays, found by sorting one hash for each row instead of the rows."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unbend.arrays import Floats, Indices, Ints

_Hashes = NDArray[np.uint64]


def equal_points(points: Floats) -> Indices:
    """Return for each row of `points` (n, 3) the first row with the same coordinates, (n,)."""
    points = np.ascontiguousarray(points) + 0.0  # turns -0.0 into 0.0, so that equal numbers have equal bits
    hashes = np.zeros(len(points), np.uint64)
    for axis in range(3):
        hashes = _mix(hashes ^ points.view(np.uint64)[:, axis])
    return _first_equal(hashes, lambda rows: points.view(np.uint64)[rows])


def equal_faces(faces: Ints, vertex_count: int) -> Indices:
    """Return for each of `faces` (m, 3) the first face with the same corners in any order, (m,)."""
    of_vertex = _mix(np.arange(vertex_count, dtype=np.uint64))
    hashes = of_vertex[faces[:, 0]] + of_vertex[faces[:, 1]] + of_vertex[faces[:, 2]]  # independent of the order
    return _first_equal(hashes, lambda rows: np.sort(faces[rows], axis=1))


def _first_equal(hashes: _Hashes, rows: Callable[[Indices], NDArray[Any]]) -> Indices:
    """Return for each row the first equal row. `rows` returns the rows of some indices, to compare equal hashes."""
    first = np.arange(len(hashes))
    ordered = np.sort(hashes)
    if not (ordered[1:] == ordered[:-1]).any():
        return first  # the usual case, several times faster than comparing rows
    order = np.argsort(hashes)
    repeats = hashes[order[1:]] == hashes[order[:-1]]
    order = order[np.append(repeats, False) | np.insert(repeats, 0, False)]
    values = rows(order)
    changes = (values[1:] != values[:-1]).any(axis=1)
    if (changes & (hashes[order[1:]] == hashes[order[:-1]])).any():
        by_value = np.lexsort(values.T)  # different rows have equal hashes, so sort by the rows themselves
        order, values = order[by_value], values[by_value]
        changes = (values[1:] != values[:-1]).any(axis=1)
    starts = np.flatnonzero(np.insert(changes, 0, True))
    lowest = np.minimum.reduceat(order, starts)
    first[order] = np.repeat(lowest, np.diff(np.append(starts, len(order))))
    return first


def _mix(keys: _Hashes) -> _Hashes:
    """Spread the bits of each key over all 64 (the finaliser of SplitMix64)."""
    keys = keys + np.uint64(0x9E3779B97F4A7C15)
    keys = (keys ^ (keys >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    keys = (keys ^ (keys >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return keys ^ (keys >> np.uint64(31))
