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

Load = Callable[[Indices], Sequence[LocalSignatures]]
"""Returns the local signatures of some rows."""

SHORTLIST: Final = 60
"""Shapes that are compared in detail."""

_LARGEST_RATIO: Final = 8
"""Area of a whole over that of a piece of unknown scale: scales are tried from 1 to about this ratio."""

_COMMON: Final = 0.4
"""Least share of the query's rings that a shape must have, too, at a scale: a few rings fit at too many scales."""

_SCALES: Final = 7
"""Scales, the best of the scan, that are compared in detail for each shape of the short list."""

_PARTS: Final = 4
"""Steps of scale to a rung. The scan tries every second one, and then both neighbours of the best one are compared."""


@dataclass(frozen=True)
class PartSearch:
    """Distances to all shapes, and the detailed comparisons with the nearest."""

    distances: Floats
    """(n,). Outside the short list: the distance of the scan, plus a constant that keeps it behind the list."""
    comparisons: Mapping[int, Comparison]
    """The detailed comparison of each shape of the short list, by its row in the gallery."""
    scanned: Floats
    """Distances of the scan alone, (n,)."""


@dataclass(frozen=True)
class _Variant:
    """A query, as it is or enlarged by a part of a rung."""

    local: LocalSignatures
    profiles: Profiles


def search_parts(
    query: LocalSignatures,
    gallery: Sequence[Profiles],
    load: Load,
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
    load : Load
    any_scale : bool, default False
        The unit of the query's vertices may differ from that of the gallery's.
    shortlist : int, default 60
    threads : int, optional
        All cores by default. The result does not depend on it.
    """
    variants = _variants(query, any_scale=any_scale)
    scans, steps = _scans(variants, gallery, any_scale=any_scale, threads=threads)
    scanned = scans.min(axis=0, initial=np.inf)
    distances = scanned.copy()
    rows = smallest(scanned, shortlist)
    shapes = load(rows)
    found: dict[int, Comparison] = {}

    def compare(part: slice) -> None:
        for row, shape in zip(rows[part].tolist(), shapes[part], strict=True):
            best = np.argsort(scans[:, row], kind="stable")[:_SCALES]
            fitting = best[np.isfinite(scans[best, row])]
            tried = {
                step: _compared(variants, step, shape, gallery[row])
                for step in steps[fitting if len(fitting) else best[:1], row].tolist()
            }
            if any_scale:
                nearest = min(tried, key=lambda step: tried[step].distance)
                tried |= {step: _compared(variants, step, shape, gallery[row]) for step in (nearest - 1, nearest + 1)}
            found[row] = min(tried.values(), key=lambda each: each.distance)

    if len(rows):
        share_out(len(rows), threads, compare)
        behind = np.ones(len(gallery), bool)
        behind[rows] = False
        added = max(found[row].distance - scanned[row] for row in found)
        distances[behind] += max(0.0, added)
        distances[rows] = [found[row].distance for row in rows.tolist()]
    return PartSearch(distances, found, scanned)


def _variants(query: LocalSignatures, *, any_scale: bool) -> list[_Variant]:
    parts = [query, *(enlarged(query, part / _PARTS) for part in range(1, _PARTS) if any_scale)]
    return [_Variant(each, profiles_of(each)) for each in parts]


def _scans(
    variants: Sequence[_Variant], gallery: Sequence[Profiles], *, any_scale: bool, threads: int | None
) -> tuple[Floats, Indices]:
    """Return the distances at each scale, (s, n), and the scales, in parts of a rung."""
    query = variants[0].profiles
    if not any_scale:
        return scan_parts(query, gallery, threads)[None], np.zeros((1, len(gallery)), np.int64)
    areas = np.array([other.area for other in gallery])
    same = np.rint(OCTAVE * np.log2(areas / query.area) / 2).astype(np.int64)  # where areas are equal
    rungs = same - np.arange(round(OCTAVE * np.log2(_LARGEST_RATIO) / 2) + 1)[:, None]
    scans, steps = [], []
    for part in range(0, _PARTS, 2):
        shifts = rungs - (part > 0)
        scanned, common = scan_shifted(variants[part].profiles, gallery, shifts, threads)
        scans.append(np.where(common >= _COMMON, scanned, np.inf))
        steps.append(_PARTS * shifts + part)
    return np.concatenate(scans), np.concatenate(steps)


def _compared(variants: Sequence[_Variant], step: int, shape: LocalSignatures, others: Profiles) -> Comparison:
    """Compare the query with a shape at a scale, in the query's own unit."""
    shift, part = divmod(step, _PARTS)
    variant, factor = variants[part], 2.0 ** (part / _PARTS / OCTAVE)
    found = compare_profiled(variant.local, variant.profiles, shape, others, shift)
    x, y, z = found.centre
    centre = (x / factor, y / factor, z / factor)
    return replace(found, residual=found.residual / factor, scale=found.scale * factor, centre=centre)
