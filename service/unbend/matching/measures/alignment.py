"""Two canonical forms laid on each other as well as a rotation, a reflection and a translation can."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import permutations, product
from typing import Final

import numpy as np

from unbend.arrays import Codes, Floats, frozen
from unbend.matching.measures.icp import LEAST_AXES, refine, residuals, spread_out
from unbend.signature.signature import Signature


@dataclass(frozen=True)
class Search:
    """How far the search for the best pose goes; benchmarks/rerank.py measures what more would find."""

    markers: int = 32
    """Points, far from each other, that stand for a form while poses are many."""
    kept: int = 24
    """Poses kept while axes are tried."""
    choosing_steps: int = 5
    """Steps by markers, before the best are chosen. They need not converge."""
    refined: int = 2
    """Poses refined by all points."""
    steps: int = 100
    """Of these, at most; about seven are usual."""


_SEARCH: Final = Search()


@dataclass(frozen=True)
class Residuals:
    """What is left between two forms: distances from points to the nearest of the other, and the points' weights."""

    distances: tuple[Floats, Floats]
    weights: tuple[Floats, Floats]


@dataclass(frozen=True)
class _Form:
    points: Floats
    """(k, m): centred, axes by falling second moments, of root mean square 1, in an order that knows no labels."""
    weights: Floats
    markers: Codes
    shares: Floats
    """Weight of the points nearest to each marker."""

    @property
    def content(self) -> bytes:
        return self.points.tobytes() + self.weights.tobytes()

    @property
    def rank(self) -> tuple[float, bytes]:
        """What tells two forms apart: their fourth moment, which knows no pose, or else their bytes."""
        return float((self.weights * (self.points**2).sum(axis=1) ** 2).sum()), self.content

    def in_axes(self, axes: int) -> Floats:
        """Return the first `axes` coordinates of the points; what is missing is zero."""
        return np.ascontiguousarray(np.pad(self.points, ((0, 0), (0, axes)))[:, :axes])


def align(a: Signature, b: Signature, search: Search = _SEARCH) -> list[Residuals]:
    """Lay the canonical form of `a` on that of `b`, and return what is left between them in the best few poses found.

    Forms are brought to a root mean square radius of 1, so neither's scale counts, nor does `Parameters.scaling`.
    Points are sorted before anything is summed, and which form moves is told by what they are: neither the order
    of the samples nor that of the arguments changes a bit of the result.

    The search starts with principal axes on principal axes. The first three are tried in all orders, with all signs;
    each further one with both signs, in its own place and in that of the one before, for axes of nearly equal moments
    may come in either order. The best poses by the markers are refined, the best of these by all points
    (`unbend.matching.measures.icp`).
    """
    first, second = sorted((_form(a, search.markers), _form(b, search.markers)), key=lambda form: form.rank)
    weights = first.weights, second.weights
    if first.content == second.content:
        nothing = np.zeros(len(first.points))
        return [Residuals((nothing, nothing), weights)]
    axes = max(LEAST_AXES, first.points.shape[1], second.points.shape[1])
    points = first.in_axes(axes), second.in_axes(axes)
    return [Residuals(residuals(motion, *points), weights) for motion in _poses(first, second, axes, search)]


def _poses(first: _Form, second: _Form, axes: int, search: Search) -> Floats:
    motions = _best(_first_poses(), 1, search.kept, first, second)
    while motions.shape[1] < axes:
        motions = _best(_with_another_axis(motions), 1, search.kept, first, second)
    motions = _best(motions, search.choosing_steps, search.refined, first, second)
    return _best(motions, search.steps, search.refined, first, second, whole=True)


def _best(motions: Floats, steps: int, count: int, first: _Form, second: _Form, *, whole: bool = False) -> Floats:
    """Refine motions, which may be of the first few axes only, and return the `count` that then cost least."""
    sides = [
        (points, np.arange(len(points), dtype=np.int32), form.weights) if whole else (points, form.markers, form.shares)
        for form in (first, second)
        for points in [form.in_axes(motions.shape[1])]
    ]
    refined = motions.copy()
    costs = refine(refined, steps, *sides[0], *sides[1])
    return np.asarray(refined[np.argsort(costs, kind="stable")[:count]])


@cache
def _first_poses() -> Floats:
    """Return the motions that flip and swap the first axes, (48, 3, 4)."""
    turns = [
        np.eye(LEAST_AXES)[list(order)] * signs
        for order in permutations(range(LEAST_AXES))
        for signs in product((1.0, -1.0), repeat=LEAST_AXES)
    ]
    return frozen(np.pad(turns, ((0, 0), (0, 0), (0, 1))), np.float64)


def _with_another_axis(motions: Floats) -> Floats:
    """Return four motions of one more axis for each of `motions` (n, m, m + 1)."""
    axes = motions.shape[1]
    wider = np.insert(np.pad(motions, ((0, 0), (0, 1), (0, 0))), axes, 0.0, axis=2)
    variants = []
    for sign in (1.0, -1.0):
        wider[:, axes, axes] = sign
        swapped = wider.copy()
        swapped[:, [axes - 1, axes]] = wider[:, [axes, axes - 1]]
        variants += [wider.copy(), swapped]
    return np.concatenate(variants)


def _form(signature: Signature, count: int) -> _Form:
    order = np.lexsort((signature.weights, *signature.points.T))
    points, weights = signature.points[order], signature.weights[order]
    centred = points - (weights[:, None] * points).sum(axis=0)
    # einsum, not @: BLAS may share a sum out among threads
    _, turn = np.linalg.eigh(np.einsum("ki,kj->ij", weights[:, None] * centred, centred))
    turned = np.einsum("ki,ij->kj", centred, turn[:, ::-1])
    radius = np.sqrt((weights[:, None] * turned**2).sum())
    posed = np.ascontiguousarray(turned / radius if radius > 0 else turned)
    markers, nearest = spread_out(posed, int((posed**2).sum(axis=1).argmax()), min(count, len(posed)))
    shares = np.bincount(nearest, weights, minlength=len(markers)).astype(np.float64)
    return _Form(posed, weights, markers, shares)
