"""Selection of the smallest of many distances in one pass."""

from __future__ import annotations

from typing import Final

import numpy as np

from unbend.arrays import Codes, Floats, Indices
from unbend.jit import inlined, kernel

_EMPTY: Final = -1  # index in an unused slot of the heap


def smallest(distances: Floats, count: int | None = None) -> Indices:
    """Return the indices of the `count` smallest (by default all) of `distances` (n,), in ascending order of distance.

    Ties are in the order of their indices. Infinite and NaN distances are left out.

    Examples
    --------
    >>> smallest(np.array([3.0, 1.0, np.inf, 1.0]), 2).tolist()
    [1, 3]
    """
    if count is None or count >= len(distances):
        order = np.argsort(distances, kind="stable")
        return order[: np.count_nonzero(distances < np.inf)]
    kept, places = np.full(count, np.inf), np.full(count, _EMPTY)
    if count:
        _keep_smallest(distances, kept, places)
    return places[np.lexsort((places, kept))][: np.count_nonzero(places != _EMPTY)]


def nearest_of_each_class(distances: Floats, codes: Codes, classes: int) -> Floats:
    """Return the smallest of `distances` (n,) in each class, (classes,); infinite for a class without members.

    `codes` (n,) are the classes of the rows. Rows with a negative code belong to no class.
    """
    nearest = np.full(classes, np.inf)
    _keep_nearest(distances, codes, nearest)
    return nearest


@inlined
def _worse(distance: float, place: int, other: float, other_place: int) -> bool:
    return distance > other or (distance == other and place > other_place)


@kernel
def _keep_smallest(distances: Floats, kept: Floats, places: Indices) -> None:
    """Fill a max-heap with the smallest distances. Among equal distances, a larger index counts as larger."""
    size = kept.shape[0]
    for place in range(distances.shape[0]):
        distance = distances[place]
        if not distance < kept[0]:
            continue
        hole, child = 0, 1
        while child < size:
            other = child + 1
            if other < size and _worse(kept[other], places[other], kept[child], places[child]):
                child = other
            if not _worse(kept[child], places[child], distance, place):
                break
            kept[hole], places[hole] = kept[child], places[child]
            hole, child = child, 2 * child + 1
        kept[hole], places[hole] = distance, place


@kernel
def _keep_nearest(distances: Floats, codes: Codes, nearest: Floats) -> None:
    for row in range(distances.shape[0]):
        code = codes[row]
        if code >= 0 and distances[row] < nearest[code]:
            nearest[code] = distances[row]
