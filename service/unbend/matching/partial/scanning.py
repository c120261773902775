"""The scan of a library for a piece: how well its circles are found on each shape, whatever their arrangement."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from unbend.arrays import Floats, Indices, Ints, Singles
from unbend.jit import kernel
from unbend.matching.partial.profiles import WIDEST, Profiles
from unbend.threads import share_out

FEWEST_RINGS: Final = 3
"""Circles with fewer rings in common are compared only if there are no others."""


def scan_parts(query: Profiles, gallery: Sequence[Profiles], threads: int | None = None) -> Floats:
    """Return the distance from `query` to each of `gallery`, (n,).

    The distance is the weighted mean, over the chosen circles of the smaller surface, of the mean difference between
    a circle's rings and those of the most similar circle on the larger surface, in units of the usual deviation.

    Parameters
    ----------
    query : Profiles
    gallery : sequence of n Profiles
    threads : int, optional
        All cores by default.
    """
    distances, _ = scan_shifted(query, gallery, np.zeros((1, len(gallery)), np.int64), threads)
    return np.asarray(distances[0])


def scan_shifted(
    query: Profiles, gallery: Sequence[Profiles], shifts: Indices, threads: int | None = None
) -> tuple[Floats, Floats]:
    """Return the distances of `scan_parts` for a query in other units, (s, n), and the share of rings in common.

    Parameters
    ----------
    query : Profiles
    gallery : sequence of n Profiles
    shifts : (s, n) int64
        Rungs by which the query's rings count as larger.
    threads : int, optional
    """
    distances, common = np.empty(shifts.shape), np.empty(shifts.shape)
    contains = np.array([other.is_open for other in gallery], bool) & (
        np.array([other.area for other in gallery]) < query.area * 2.0 ** (shifts / 2)
    )

    def fill(part: slice) -> None:
        for row in range(part.start, part.stop):
            other, turned = gallery[row], contains[:, row]
            if not turned.all():
                distances[~turned, row], common[~turned, row] = _scanned(query, other, shifts[~turned, row])
            if turned.any():
                distances[turned, row], common[turned, row] = _scanned(other, query, -shifts[turned, row])

    if len(gallery):
        share_out(len(gallery), threads, fill)
    return distances, common


def _scanned(small: Profiles, large: Profiles, shifts: Indices) -> tuple[Floats, Floats]:
    result, common = np.empty(len(shifts)), np.empty(len(shifts))
    offsets = large.first - small.first - shifts
    _mean_nearest(small.values, small.chosen, small.rings, small.weights, large.values, offsets, result, common)
    return result, common


def ordered(query: Profiles, other: Profiles, shift: int) -> tuple[Profiles, Profiles, int]:
    """Return the surface whose circles are sought, the surface on which they are sought, and the former's shift.

    The circles of `other` are sought if it is open and smaller than the query; otherwise those of the query.
    """
    contains = other.is_open and other.area < query.area * 2.0 ** (shift / 2)
    return (other, query, -shift) if contains else (query, other, shift)


def differences(small: Profiles, large: Profiles, moved: int) -> Singles:
    """Return the mean difference of each chosen circle of `small` from each circle of `large`, (m, c)."""
    result = np.empty((len(small.chosen), large.values.shape[1]), np.float32)
    _differences(small.values, small.chosen, small.rings, large.values, large.first - small.first - moved, result)
    return result


@kernel
def least(values: Singles) -> float:
    """Return the smallest of `values`, which are overwritten: halves are compared, which fills vector registers."""
    count = len(values)
    while count > 1:
        half = (count + 1) // 2
        for index in range(count - half):
            values[index] = min(values[index], values[index + half])
        count = half
    return float(values[0])


@kernel
def _common(rings: int, offset: int, sought: int, given: int) -> tuple[int, int]:
    """Return the range of a sought circle's rings that the given surface has, too."""
    return max(0, offset), min(rings, sought, offset + min(WIDEST, given))


@kernel
def _sums(values: Singles, centre: int, large: Singles, start: int, end: int, offset: int, sums: Singles) -> None:
    """Write the sums of the differences of some rings of a centre from those of each circle of `large`."""
    sums[:] = np.float32(0)
    for ring in range(start, end):
        sought, given = values[ring, centre], large[ring - offset]
        for column in range(len(sums)):
            sums[column] += abs(sought - given[column])


@kernel
def _differences(values: Singles, chosen: Indices, rings: Ints, large: Singles, offset: int, result: Singles) -> None:
    for row in range(len(chosen)):
        start, end = _common(rings[row], offset, len(values), len(large))
        if end - start < 1:
            result[row] = np.inf
        else:
            _sums(values, chosen[row], large, start, end, offset, result[row])
            result[row] /= np.float32(end - start)


@kernel
def _mean_nearest(
    values: Singles,
    chosen: Indices,
    rings: Ints,
    weights: Singles,
    large: Singles,
    offsets: Indices,
    result: Floats,
    common: Floats,
) -> None:
    sums = np.empty(large.shape[1], np.float32)
    for index, offset in enumerate(offsets):
        shared, every = 0.0, 0.0
        for row in range(len(chosen)):
            start, end = _common(rings[row], offset, len(values), len(large))
            shared += weights[row] * max(0, end - start) / rings[row]
            every += weights[row]
        common[index] = shared / every if every > 0 else 1.0
        total, weight = 0.0, 0.0
        for fewest in (FEWEST_RINGS, 1):
            for row in range(len(chosen)):
                start, end = _common(rings[row], offset, len(values), len(large))
                if end - start >= fewest:
                    _sums(values, chosen[row], large, start, end, offset, sums)
                    total += weights[row] * least(sums) / (end - start)
                    weight += weights[row]
            if weight > 0:
                break
        result[index] = total / weight if weight > 0 else np.inf
