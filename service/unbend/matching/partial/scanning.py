"""The scan of a library for a piece: how well its circles are found on each shape, whatever their arrangement."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from unbend.arrays import Floats, Indices, Ints, Singles
from unbend.jit import kernel, summing
from unbend.matching.partial.profiles import WIDEST, Profiles
from unbend.threads import share_out

FEWEST_RINGS: Final = 3
"""Circles with fewer rings in common are compared only if there are no others."""


def scan_parts(query: Profiles, gallery: Sequence[Profiles], shift: int = 0, threads: int | None = None) -> Floats:
    """Return the distance from `query` to each of `gallery`, (n,).

    The distance is the weighted mean, over the chosen circles of the smaller surface, of the mean difference between
    a circle's rings and those of the most similar circle on the larger surface, in units of the usual deviation.

    Parameters
    ----------
    query : Profiles
    gallery : sequence of n Profiles
    shift : int, default 0
        Rungs by which the query's rings count as larger, for a query in another unit.
    threads : int, optional
        All cores by default.
    """
    distances = np.empty(len(gallery))

    def fill(part: slice) -> None:
        for row in range(part.start, part.stop):
            small, large, moved = ordered(query, gallery[row], shift)
            distances[row] = _mean_nearest(
                small.values, small.chosen, small.rings, small.weights, large.values, large.first - small.first - moved
            )

    if len(gallery):
        share_out(len(gallery), threads, fill)
    return distances


def ordered(query: Profiles, other: Profiles, shift: int) -> tuple[Profiles, Profiles, int]:
    """Return the surface whose circles are sought, the surface on which they are sought, and the former's shift.

    The smaller open surface may be a piece of the other one. Between two closed surfaces, the query's circles are
    sought.
    """
    contains = other.is_open and other.area < query.area * 2.0 ** (shift / 2)
    return (other, query, -shift) if contains else (query, other, shift)


def differences(small: Profiles, large: Profiles, moved: int) -> Singles:
    """Return the mean difference of each chosen circle of `small` from each circle of `large`, (m, c)."""
    result = np.empty((len(small.chosen), len(large.values)), np.float32)
    _differences(small.values, small.chosen, small.rings, large.values, large.first - small.first - moved, result)
    return result


@summing
def _difference(sought: Singles, given: Singles, start: int, end: int, offset: int) -> float:
    total = np.float32(0)
    for ring in range(start, end):
        total += abs(sought[ring] - given[ring - offset])
    return float(total / np.float32(end - start))


@kernel
def _common(rings: int, offset: int, sought: int, given: int) -> tuple[int, int]:
    """Return the range of a sought circle's rings that the given surface has, too."""
    return max(0, offset), min(rings, sought, offset + min(WIDEST, given))


@kernel
def _differences(values: Singles, chosen: Indices, rings: Ints, large: Singles, offset: int, result: Singles) -> None:
    for row in range(len(chosen)):
        start, end = _common(rings[row], offset, values.shape[1], large.shape[1])
        for column in range(len(large)):
            if end - start < 1:
                result[row, column] = np.inf
            else:
                result[row, column] = _difference(values[chosen[row]], large[column], start, end, offset)


@kernel
def _mean_nearest(
    values: Singles, chosen: Indices, rings: Ints, weights: Singles, large: Singles, offset: int
) -> float:
    total, weight = 0.0, 0.0
    for fewest in (FEWEST_RINGS, 1):
        for row in range(len(chosen)):
            start, end = _common(rings[row], offset, values.shape[1], large.shape[1])
            if end - start >= fewest:
                nearest = np.inf
                for column in range(len(large)):
                    nearest = min(nearest, _difference(values[chosen[row]], large[column], start, end, offset))
                total += weights[row] * nearest
                weight += weights[row]
        if weight > 0:
            break
    return total / weight if weight > 0 else np.inf
