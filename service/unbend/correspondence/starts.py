"""Candidates: how the canonical forms of two surfaces may lie on each other, with all reflections."""

from __future__ import annotations

from itertools import permutations, product
from typing import Final

import numpy as np

from unbend.arrays import Floats
from unbend.correspondence.features import Features
from unbend.correspondence.growth import PointMap
from unbend.correspondence.nearest import nearest_rows

_MARKERS: Final = 100
"""Samples of each form that are paired while there are many poses."""

_STEPS: Final = 8
"""Steps of iterative closest points. They need not converge, because candidates grow afterwards."""

_SAME: Final = 0.3
"""Two poses are the same candidate if no entry of their rotations differs by more."""


def candidate_maps(a: Features, b: Features, count: int) -> list[PointMap]:
    """Return up to `count` maps between the samples, the best first.

    The principal axes of the forms are matched in all orders and with all signs, then each pose is refined by
    iterative closest points (Besl & McKay 1992).
    """
    markers = min(_MARKERS, len(a.samples), len(b.samples))
    ours, theirs = a.points[a.samples[:markers]], b.points[b.samples[:markers]]
    ours, theirs = ours - ours.mean(axis=0), theirs - theirs.mean(axis=0)
    poses = sorted((_closest_points(ours, theirs, turn) for turn in _turns(ours.shape[1])), key=lambda pose: pose[0])
    chosen: list[Floats] = []
    for _, turn in poses:
        if len(chosen) < count and all(np.abs(turn - other).max() > _SAME for other in chosen):
            chosen.append(turn)
    return [_map(a, b, turn) for turn in chosen]


def _turns(axes: int) -> Floats:
    """Return matrices that permute the first three axes and flip any, (n, axes, axes)."""
    turns = []
    for order in permutations(range(3)):
        moved = np.eye(axes)[[*order, *range(3, axes)]]
        turns += [moved * signs for signs in product((1.0, -1.0), repeat=axes)]
    return np.array(turns)


def _closest_points(ours: Floats, theirs: Floats, turn: Floats) -> tuple[float, Floats]:
    """Refine a rotation or reflection; return its mean squared distance between nearest points, and itself."""
    for _ in range(_STEPS):
        moved = ours @ turn
        to, back = nearest_rows(moved, theirs), nearest_rows(theirs, moved)
        left, _, right = np.linalg.svd(ours.T @ theirs[to] + ours[back].T @ theirs)
        turn = left @ right
    moved = ours @ turn
    cost = ((moved - theirs[nearest_rows(moved, theirs)]) ** 2).sum(axis=1).mean()
    return float(cost + ((theirs - moved[nearest_rows(theirs, moved)]) ** 2).sum(axis=1).mean()), turn


def _map(a: Features, b: Features, turn: Floats) -> PointMap:
    moved = a.points @ turn
    return PointMap(nearest_rows(moved[a.samples], b.points), nearest_rows(b.points[b.samples], moved))
