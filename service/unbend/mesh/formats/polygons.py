"""Polygons of any format, cut into triangles.

As in other programs, a fan of triangles around the first corner is used if it covers the polygon exactly once. If it
does not, fans around the next four corners are tried: in a simple quad or pentagon, one of the five works. Ear clipping
(mapbox-earcut) cuts all other polygons. Coverage is tested in the plane normal to the polygon's vector area (Newell's
normal), in which the projected area of a polygon that is not flat is largest.
"""

from __future__ import annotations

import itertools
from typing import Any, Final

import mapbox_earcut
import numpy as np

from unbend.arrays import Bools, Floats, Indices
from unbend.errors import MeshReadError
from unbend.mesh.formats.spans import firsts_of, spans
from unbend.mesh.limits import MeshLimits
from unbend.mesh.report import counted_noun
from unbend.tolerances import FLAT_CORNER

_BLOCK: Final = 2**20  # corners per block
_TURNS: Final = 5  # corners that are tried as centres of fans, enough for every simple pentagon
_MOST: Final = 100_000  # largest number of corners for ear clipping, which takes quadratic time: this many take seconds


def triangulated(
    vertices: Floats, corners: Indices, counts: Indices, limits: MeshLimits
) -> tuple[Indices, tuple[str, ...]]:
    """Return triangles (m, 3) in the order of their polygons, and notes on polygons that were changed or skipped.

    Parameters
    ----------
    vertices : (n, 3) float64
    corners : (k,) int64
        Indices of vertices, polygon after polygon, each of them valid.
    counts : (p,) int64
        Number of corners of each polygon. Polygons of fewer than three corners are skipped.
    limits : MeshLimits

    Raises
    ------
    MeshTooLargeError
        If there would be more triangles than `limits` allow. This is checked before any are made.
    MeshReadError
        If a polygon that needs clipping has more than 100,000 corners.
    """
    limits.check(0, int(np.maximum(counts - 2, 0).sum()))
    if (counts == 3).all():
        return corners.reshape(-1, 3), ()
    corners, counts, notes = _tidy(corners, counts)
    faces, bad, firsts = [np.empty((0, 3), np.int64)], 0, firsts_of(counts)
    for begin, end in _blocks(counts):
        block = corners[firsts[begin] :][: counts[begin:end].sum()]
        cut, uncovered = _cut(vertices, block, counts[begin:end])
        faces.append(cut)
        bad += uncovered
    if bad:
        notes += (f"{counted_noun(bad, 'polygon', 'polygons')} with crossing edges or no area: cut arbitrarily",)
    return np.concatenate(faces), notes


def _tidy(corners: Indices, counts: Indices) -> tuple[Indices, Indices, tuple[str, ...]]:
    """Return the polygons of three or more corners, without corners that repeat the previous corner, and notes."""
    owner = np.repeat(np.arange(len(counts)), counts)
    following = np.arange(len(corners)) + 1
    last = np.cumsum(counts)[counts > 0]
    following[last - 1] = last - counts[counts > 0]
    repeated = (corners[following] == corners) & (counts[owner] > 3)  # triangles keep them: repair counts such faces
    counts = counts - np.bincount(owner[repeated], minlength=len(counts))
    kept = counts >= 3
    notes = []
    if number := int(repeated.sum()):
        notes.append(f"{counted_noun(number, 'repeated corner', 'repeated corners')} skipped")
    if number := int((~kept).sum()):
        notes.append(f"{counted_noun(number, 'face', 'faces')} of fewer than three corners skipped")
    return corners[~repeated & kept[owner]], counts[kept], tuple(notes)


def _blocks(counts: Indices) -> list[tuple[int, int]]:
    """Return ranges of polygons with about `_BLOCK` corners each."""
    cuts = np.flatnonzero(np.diff(np.cumsum(counts) // _BLOCK)) + 1
    edges = [0, *cuts.tolist(), len(counts)]
    return [(begin, end) for begin, end in itertools.pairwise(edges) if begin < end]


def _cut(vertices: Floats, corners: Indices, counts: Indices) -> tuple[Indices, int]:
    """Return the triangles of some polygons, and the number of polygons that no triangulation covers exactly once."""
    faces, owners = _fans(corners, counts)
    wrong = np.flatnonzero(~_covered_once(vertices[corners], counts))
    pieces, replaced, bad, firsts = [], [np.empty(0, np.int64)], 0, firsts_of(counts)
    for turn in range(1, _TURNS if len(wrong) else 1):
        sizes = counts[wrong]
        rings = _turned(corners[spans(firsts[wrong], sizes)], sizes, turn)
        right = _covered_once(vertices[rings], sizes)
        fans, of = _fans(rings, sizes)
        pieces.append(fans[right[of]])
        replaced.append(wrong[of[right[of]]])
        wrong = wrong[~right]
    for polygon in wrong:
        ring = corners[firsts[polygon] :][: counts[polygon]]
        ears, good = _clipped(vertices[ring]) if len(ring) > _TURNS else (np.empty((0, 3), np.int64), False)
        pieces.append(ring[ears])
        replaced.append(np.full(len(ears), polygon))
        bad += not good
    kept = ~np.isin(owners, np.concatenate(replaced))
    order = np.argsort(np.concatenate([owners[kept], *replaced]), kind="stable")
    return np.concatenate([faces[kept], *pieces])[order], bad


def _turned(rings: Indices, counts: Indices, turn: int) -> Indices:
    """Return the polygons, each starting `turn` corners later."""
    firsts = np.repeat(firsts_of(counts), counts)
    return rings[firsts + (np.arange(len(rings)) - firsts + turn) % np.repeat(counts, counts)]


def _fans(corners: Indices, counts: Indices) -> tuple[Indices, Indices]:
    """Return triangles around the first corner of each polygon, and the polygon of each triangle."""
    owners = np.repeat(np.arange(len(counts)), counts - 2)
    behind = spans(firsts_of(counts) + 1, counts - 2)
    return np.stack([corners[firsts_of(counts)[owners]], corners[behind], corners[behind + 1]], axis=1), owners


def _covered_once(points: Floats, counts: Indices) -> Bools:
    """Return a mask, (p,), of the polygons that the fan around the first corner covers without flips or overlaps.

    A polygon with a corner that is not finite counts as covered, because repair drops and reports its triangles.
    """
    firsts, each = firsts_of(counts), counts - 2
    with np.errstate(all="ignore"):
        around = points - np.repeat(points[firsts], counts, axis=0)
        size = np.maximum.reduceat(np.abs(around).max(axis=1), firsts)
        around /= np.repeat(size, counts)[:, None]
        behind = spans(firsts + 1, each)
        cross = np.cross(around[behind], around[behind + 1])
        normal = np.add.reduceat(cross, firsts_of(each))
        length = np.linalg.norm(normal, axis=1)
        signed = (cross * np.repeat(normal / length[:, None], each, axis=0)).sum(axis=1)
        turn = np.arctan2(signed, (around[behind] * around[behind + 1]).sum(axis=1))
        lowest = np.minimum.reduceat(signed, firsts_of(each))
        once = (lowest >= -FLAT_CORNER * length) & (np.add.reduceat(turn, firsts_of(each)) < 2 * np.pi)
    covered: Bools = once | (counts == 3) | ~np.isfinite(size)
    return covered


def _clipped(points: Floats) -> tuple[Indices, bool]:
    """Return the triangles of one polygon, as indices of its corners (k, 3), and whether they cover it exactly once."""
    if len(points) > _MOST:
        raise MeshReadError(f"a face that is not convex has {len(points):,} corners: at most {_MOST:,} are supported")
    around = points - points[0]
    around /= np.abs(around).max()
    normal = np.cross(around[1:-1], around[2:]).sum(axis=0)
    length = np.linalg.norm(normal)
    if not length > 0:
        return np.empty((0, 3), np.int64), False
    across = np.cross(normal / length, np.eye(3)[np.abs(normal).argmin()])
    across /= np.linalg.norm(across)
    flat = np.stack([around @ across, around @ np.cross(normal / length, across)], axis=1)
    clipped: Any = mapbox_earcut.triangulate_float64(np.ascontiguousarray(flat), np.array([len(flat)], np.uint32))
    ears = clipped.astype(np.int64).reshape(-1, 3)
    twice = _twice_area(flat[ears])
    ears[twice < 0] = ears[twice < 0][:, ::-1]
    return _with_all_corners(ears, len(points)), bool(abs(np.abs(twice).sum() - length) <= FLAT_CORNER * length)


def _twice_area(triangles: Floats) -> Floats:
    first, second = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    twice: Floats = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    return twice


def _with_all_corners(ears: Indices, count: int) -> Indices:
    """Return the triangles, cut so that every corner of the polygon is used.

    Ear clipping leaves out corners on a straight side. The neighbouring faces use these corners, so the surface would
    have gaps there. A triangle with such corners on an edge is therefore cut at the corners.
    """
    edges = {edge for a, b, c in ears.tolist() for edge in ((a, b), (b, c), (c, a))}
    used = set(ears.ravel().tolist())
    waiting, done = ears.tolist()[::-1], []
    while waiting:
        triangle = waiting.pop()
        for a, b, c in (triangle, triangle[1:] + triangle[:1], triangle[2:] + triangle[:2]):
            if (a, b) not in edges or (b, a) in edges:
                continue
            between = [corner % count for corner in range(a + 1, a + (b - a) % count)]
            if between and used.isdisjoint(between):
                chain = [a, *between, b]
                waiting += [[chain[i], chain[i + 1], c] for i in range(len(chain) - 1)]
                break
        else:
            done.append(triangle)
    return np.array(done, np.int64).reshape(-1, 3)
