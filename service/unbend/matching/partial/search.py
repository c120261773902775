"""Search for the wholes of a piece, or the pieces of a whole: a scan, then a comparison of the nearest in detail."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from unbend.arrays import Floats, Indices
from unbend.local.signatures import OCTAVE, LocalSignatures, enlarged
from unbend.matching.partial.comparison import Comparison, compare_parts
from unbend.matching.partial.profiles import Profiles, profiles_of
from unbend.matching.partial.scanning import scan_parts
from unbend.matching.selection import smallest

SHORTLIST: Final = 60
"""Shapes that are compared in detail."""

_LARGEST_SHARE: Final = 8
"""A piece of unknown scale is sought at least as large as a whole, and at most this many times smaller in area."""

_SCALES: Final = 4
"""Scales, the best of the scan, that are compared in detail for each shape of the short list."""


@dataclass(frozen=True)
class PartSearch:
    """Distances to all shapes, and the detailed comparisons with the nearest."""

    distances: Floats
    """(n,). Shapes outside the short list keep the distance of the scan, but are behind those of the list."""
    comparisons: Mapping[int, Comparison]
    """By row."""
    scanned: Floats
    """Distances of the scan alone, (n,)."""


@dataclass(frozen=True)
class _Trial:
    """A scale: a variant of the query, as it is or half a rung larger, and its shift for each row, (n,)."""

    variant: int
    shifts: Indices


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
    variants = [query, enlarged(query)] if any_scale else [query]
    scans, trials = _scans(variants, gallery, any_scale=any_scale)
    scanned = scans.min(axis=0)
    distances = scanned.copy()
    rows = smallest(scanned, shortlist)
    found = {}
    for row, shape in zip(rows.tolist(), load(rows), strict=True):
        best = np.argsort(scans[:, row], kind="stable")[:_SCALES].tolist()
        compared = [_compared(variants, shape, trials[trial], row) for trial in best]
        found[row] = min(compared, key=lambda each: each.distance)
    if found:
        behind = np.ones(len(gallery), bool)
        behind[rows] = False
        added = max(found[row].distance - scanned[row] for row in found)
        distances[behind] += max(0.0, added)
        distances[rows] = [found[row].distance for row in rows.tolist()]
    return PartSearch(distances, found, scanned)


def _scans(
    variants: Sequence[LocalSignatures], gallery: Sequence[Profiles], *, any_scale: bool
) -> tuple[Floats, list[_Trial]]:
    """Return the distances at each scale, (s, n), and the scales."""
    profiles = [profiles_of(variant) for variant in variants]
    if not any_scale:
        return scan_parts(profiles[0], gallery)[None], [_Trial(0, np.zeros(len(gallery), np.int64))]
    scans, trials = [], []
    areas = np.array([other.area for other in gallery])
    for variant, query in enumerate(profiles):
        same = np.rint(OCTAVE * np.log2(areas / query.area) / 2).astype(np.int64)  # where both areas are equal
        for step in range(round(OCTAVE * np.log2(_LARGEST_SHARE) / 2) + 1):
            trials.append(_Trial(variant, same - step))
            scans.append(_scan_shifted(query, gallery, same - step))
    return np.array(scans).reshape(len(scans), len(gallery)), trials


def _scan_shifted(query: Profiles, gallery: Sequence[Profiles], shifts: Indices) -> Floats:
    distances = np.empty(len(gallery))
    for shift in np.unique(shifts).tolist():
        rows = np.flatnonzero(shifts == shift)
        distances[rows] = scan_parts(query, [gallery[row] for row in rows.tolist()], shift)
    return distances


def _compared(variants: Sequence[LocalSignatures], shape: LocalSignatures, trial: _Trial, row: int) -> Comparison:
    """Compare one variant of the query with a shape, in the query's own unit."""
    factor = float(np.sqrt(variants[trial.variant].area / variants[0].area))
    found = compare_parts(variants[trial.variant], shape, int(trial.shifts[row]))
    return replace(found, residual=found.residual / factor, scale=found.scale * factor)
