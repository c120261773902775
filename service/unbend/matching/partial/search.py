"""Search for the wholes of a piece, or the pieces of a whole: a scan, then a comparison of the nearest in detail."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from unbend.arrays import Floats, Indices
from unbend.local.signatures import OCTAVE, LocalSignatures
from unbend.matching.partial.comparison import Comparison, compare_parts
from unbend.matching.partial.profiles import Profiles, profiles_of
from unbend.matching.partial.scanning import scan_parts
from unbend.matching.selection import smallest

SHORTLIST: Final = 60
"""Shapes that are compared in detail."""

_LARGEST_SHARE: Final = 8
"""A piece of unknown scale is sought at least as large as a whole, and at most this many times smaller in area."""

_SCALES: Final = 2
"""Scales, the best of the scan, that are compared in detail for each shape of the short list."""


@dataclass(frozen=True)
class PartSearch:
    """Distances to all shapes, and the detailed comparisons with the nearest."""

    distances: Floats
    """(n,). Shapes outside the short list keep the distance of the scan, but are behind those of the list."""
    comparisons: Mapping[int, Comparison]
    """By row."""


def search_parts(
    query: LocalSignatures,
    gallery: Sequence[Profiles],
    load: Callable[[Indices], Sequence[LocalSignatures]],
    *,
    any_scale: bool = False,
    shortlist: int = SHORTLIST,
) -> PartSearch:
    """Compare a query with all shapes of a gallery.

    Parameters
    ----------
    query : LocalSignatures
    gallery : sequence of n Profiles
    load : callable
        Returns the local signatures of some rows.
    any_scale : bool, default False
        The unit of the query's vertices may differ from that of the gallery's.
    shortlist : int, default 60
    """
    profiles = profiles_of(query)
    scans, shifts = _scans(profiles, gallery) if any_scale else (scan_parts(profiles, gallery)[None], None)
    distances = scans.min(axis=0)
    rows = smallest(distances, shortlist)
    found = {}
    for row, shape in zip(rows.tolist(), load(rows), strict=True):
        tried = [0] if shifts is None else shifts[np.argsort(scans[:, row], kind="stable")[:_SCALES], row].tolist()
        found[row] = min((compare_parts(query, shape, shift) for shift in tried), key=lambda each: each.distance)
    if found:
        behind = np.ones(len(gallery), bool)
        behind[rows] = False
        added = max(found[row].distance - distances[row] for row in found)
        distances[behind] += max(0.0, added)
        distances[rows] = [found[row].distance for row in rows.tolist()]
    return PartSearch(distances, found)


def _scans(query: Profiles, gallery: Sequence[Profiles]) -> tuple[Floats, Indices]:
    """Return the distances at all scales, (s, n), and the shift of each, (s, n)."""
    steps = np.arange(round(OCTAVE * np.log2(_LARGEST_SHARE) / 2) + 1)
    ratio = np.array([other.area / query.area for other in gallery])
    same = np.rint(OCTAVE * np.log2(ratio) / 2).astype(np.int64)  # the shift at which the areas are equal
    shifts = same[None] - steps[:, None]
    scans = np.empty(shifts.shape)
    for shift in np.unique(shifts).tolist():
        for step, row in zip(*np.nonzero(shifts == shift), strict=True):
            scans[step, row] = scan_parts(query, [gallery[row]], shift, threads=1)[0]
    return scans, shifts
