"""Alignment of two canonical forms by a rotation, a reflection and a translation."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import permutations, product
from typing import Final

import numpy as np

from unbend.arrays import Codes, Floats, frozen
from unbend.matching.measures.icp import MIN_AXES, farthest_points, refine, residuals
from unbend.signature.signature import Signature


@dataclass(frozen=True)
class Search:
    """The effort of the search for the best pose. benchmarks/retrieval/rerank.py compares it with a wider search."""

    markers: int = 32
    """Number of points, far from each other, that represent a form while there are many poses."""
    kept: int = 24
    """Number of poses that are kept while axes are added."""
    marker_steps: int = 5
    """Refinement steps with markers before the best poses are chosen. They need not converge."""
    refined: int = 2
    """Number of poses that are then refined with all points."""
    steps: int = 100
    """Largest number of refinement steps with all points. Usually about seven are made."""


_SEARCH: Final = Search()


@dataclass(frozen=True)
class Residuals:
    """The distances from the points of each of two aligned forms to the nearest of the other, and their weights."""

    distances: tuple[Floats, Floats]
    weights: tuple[Floats, Floats]


@dataclass(frozen=True)
class _Form:
    points: Floats
    """(k, m): centred, along the principal axes, with root mean square radius 1. The order of the points does not
    depend on the order of the samples."""
    weights: Floats
    markers: Codes
    marker_weights: Floats
    """Total weight of the points nearest to each marker."""

    def to_bytes(self) -> bytes:
        return self.points.tobytes() + self.weights.tobytes()

    def sort_key(self) -> tuple[float, bytes]:
        """Return the fourth moment, which does not depend on the pose, and the bytes, which break ties."""
        return float((self.weights * (self.points**2).sum(axis=1) ** 2).sum()), self.to_bytes()

    def first_axes(self, axes: int) -> Floats:
        """Return the first `axes` coordinates of the points, padded with zeros."""
        return np.ascontiguousarray(np.pad(self.points, ((0, 0), (0, axes)))[:, :axes])


def align(a: Signature, b: Signature, search: Search = _SEARCH) -> list[Residuals]:
    """Align the canonical forms of `a` and `b`, and return the residual distances in the best few poses.

    Forms are scaled to a root mean square radius of 1, so the result depends neither on their scale nor on
    `Parameters.scaling`. Points are sorted before they are summed, and the content of the forms decides which form
    moves. So the result is exactly the same for any order of the samples and of the arguments.

    The search first aligns principal axes. It tries the first three in all orders and with all signs. It tries each
    further axis with both signs, both in its own place and swapped with the previous axis, because axes of nearly equal
    moments may come in either order. The best poses are refined with markers, and the best of these with all points
    (`unbend.matching.measures.icp`).
    """
    first, second = sorted((_form(a, search.markers), _form(b, search.markers)), key=_Form.sort_key)
    weights = first.weights, second.weights
    if first.to_bytes() == second.to_bytes():
        zeros = np.zeros(len(first.points))
        return [Residuals((zeros, zeros), weights)]
    axes = max(MIN_AXES, first.points.shape[1], second.points.shape[1])
    points = first.first_axes(axes), second.first_axes(axes)
    return [Residuals(residuals(motion, *points), weights) for motion in _poses(first, second, axes, search)]


def _poses(first: _Form, second: _Form, axes: int, search: Search) -> Floats:
    motions = _best(_initial_motions(), 1, search.kept, first, second)
    while motions.shape[1] < axes:
        motions = _best(_with_one_more_axis(motions), 1, search.kept, first, second)
    motions = _best(motions, search.marker_steps, search.refined, first, second)
    return _best(motions, search.steps, search.refined, first, second, all_points=True)


def _best(motions: Floats, steps: int, count: int, first: _Form, second: _Form, *, all_points: bool = False) -> Floats:
    """Refine motions, which may have only the first few axes, and return the `count` motions of least cost."""
    sides = [
        (points, np.arange(len(points), dtype=np.int32), form.weights)
        if all_points
        else (points, form.markers, form.marker_weights)
        for form in (first, second)
        for points in [form.first_axes(motions.shape[1])]
    ]
    refined = motions.copy()
    costs = refine(refined, steps, *sides[0], *sides[1])
    return np.asarray(refined[np.argsort(costs, kind="stable")[:count]])


@cache
def _initial_motions() -> Floats:
    """Return the motions that permute and flip the first axes, (48, 3, 4)."""
    turns = [
        np.eye(MIN_AXES)[list(order)] * signs
        for order in permutations(range(MIN_AXES))
        for signs in product((1.0, -1.0), repeat=MIN_AXES)
    ]
    return frozen(np.pad(turns, ((0, 0), (0, 0), (0, 1))), np.float64)


def _with_one_more_axis(motions: Floats) -> Floats:
    """Return, for each of `motions` (n, m, m + 1), four motions with one more axis."""
    axes = motions.shape[1]
    wider = np.insert(np.pad(motions, ((0, 0), (0, 1), (0, 0))), axes, 0.0, axis=2)
    variants = []
    for sign in (1.0, -1.0):
        wider[:, axes, axes] = sign
        swapped = wider.copy()
        swapped[:, [axes - 1, axes]] = wider[:, [axes, axes - 1]]
        variants += [wider.copy(), swapped]
    return np.concatenate(variants)


def _form(signature: Signature, markers: int) -> _Form:
    order = np.lexsort((signature.weights, *signature.points.T))
    points, weights = signature.points[order], signature.weights[order]
    centred = points - (weights[:, None] * points).sum(axis=0)
    # einsum instead of @, because BLAS may split a sum among threads and then round it differently
    _, axes = np.linalg.eigh(np.einsum("ki,kj->ij", weights[:, None] * centred, centred))
    turned = np.einsum("ki,ij->kj", centred, axes[:, ::-1])
    radius = np.sqrt((weights[:, None] * turned**2).sum())
    posed = np.ascontiguousarray(turned / radius if radius > 0 else turned)
    chosen, nearest = farthest_points(posed, int((posed**2).sum(axis=1).argmax()), min(markers, len(posed)))
    marker_weights = np.bincount(nearest, weights, minlength=len(chosen)).astype(np.float64)
    return _Form(posed, weights, chosen, marker_weights)
