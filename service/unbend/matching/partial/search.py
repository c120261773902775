"""Search for the wholes of a piece, or the pieces of a whole: a scan, then a comparison of the nearest in detail."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from unbend.arrays import Floats, Indices
from unbend.local.signatures import OCTAVE, LocalSignatures, enlarged
from unbend.matching.partial.comparison import Comparison, compare_profiled
from unbend.matching.partial.profiles import Profiles, profiles_of
from unbend.matching.partial.scanning import scan_parts, scan_shifted
from unbend.matching.selection import smallest
from unbend.threads import share_out

SHORTLIST: Final = 60
"""Shapes that are compared in detail."""

_LARGEST_SHARE: Final = 8
"""A piece of unknown scale is sought at least as large as a whole, and at most this many times smaller in area."""

_COMMON: Final = 0.4
"""Least share of the query's rings that a shape must have, too, at a scale: a few rings fit at too many scales."""

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
class _Variant:
    """A query, as it is or half a rung larger."""

    local: LocalSignatures
    profiles: Profiles


@dataclass(frozen=True)
class _Trial:
    """A scale: a variant of the query, and its shift for each row, (n,)."""

    variant: _Variant
    shifts: Indices


def search_parts(
    query: LocalSignatures,
    gallery: Sequence[Profiles],
    load: Callable[[Indices], Sequence[LocalSignatures]],
    *,
    any_scale: bool = False,
    shortlist: int = SHORTLIST,
    threads: int | None = None,
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
    threads : int, optional
        All cores by default. The result does not depend on it.
    """
    scans, trials = _scans(query, gallery, any_scale=any_scale, threads=threads)
    scanned = scans.min(axis=0)
    distances = scanned.copy()
    rows = smallest(scanned, shortlist)
    shapes = load(rows)
    found: dict[int, Comparison] = {}

    def compare(part: slice) -> None:
        for row, shape in zip(rows[part].tolist(), shapes[part], strict=True):
            best = np.argsort(scans[:, row], kind="stable")[:_SCALES].tolist()
            fitting = [trial for trial in best if np.isfinite(scans[trial, row])] or best[:1]
            compared = [_compared(query, trials[trial], shape, gallery[row], row) for trial in fitting]
            found[row] = min(compared, key=lambda each: each.distance)

    if len(rows):
        share_out(len(rows), threads, compare)
        behind = np.ones(len(gallery), bool)
        behind[rows] = False
        added = max(found[row].distance - scanned[row] for row in found)
        distances[behind] += max(0.0, added)
        distances[rows] = [found[row].distance for row in rows.tolist()]
    return PartSearch(distances, found, scanned)


def _scans(
    query: LocalSignatures, gallery: Sequence[Profiles], *, any_scale: bool, threads: int | None
) -> tuple[Floats, list[_Trial]]:
    """Return the distances at each scale, (s, n), and the scales."""
    variant = _Variant(query, profiles_of(query))
    if not any_scale:
        scanned = scan_parts(variant.profiles, gallery, threads)
        return scanned[None], [_Trial(variant, np.zeros(len(gallery), np.int64))]
    scans, trials = [], []
    areas = np.array([other.area for other in gallery])
    larger = enlarged(query)
    for variant in (variant, _Variant(larger, profiles_of(larger))):
        same = np.rint(OCTAVE * np.log2(areas / variant.local.area) / 2).astype(np.int64)  # where areas are equal
        shifts = same - np.arange(round(OCTAVE * np.log2(_LARGEST_SHARE) / 2) + 1)[:, None]
        scanned, common = scan_shifted(variant.profiles, gallery, shifts, threads)
        scans.append(np.where(common >= _COMMON, scanned, np.inf))
        trials += [_Trial(variant, each) for each in shifts]
    return np.concatenate(scans), trials


def _compared(query: LocalSignatures, trial: _Trial, shape: LocalSignatures, others: Profiles, row: int) -> Comparison:
    """Compare one variant of the query with a shape, in the query's own unit."""
    variant = trial.variant
    factor = float(np.sqrt(variant.local.area / query.area))
    found = compare_profiled(variant.local, variant.profiles, shape, others, int(trial.shifts[row]))
    return replace(found, residual=found.residual / factor, scale=found.scale * factor)
