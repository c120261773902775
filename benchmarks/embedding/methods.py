"""Minimisers of the stress, compared by how many evaluations of B(X) X each needs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise

import numpy as np

from unbend.embedding.gradient import StressGradient
from unbend.embedding.quasi_newton import minimise
from unbend.threads import Team

Array = np.ndarray
Search = Callable[["Recorder", Array], object]

MOST = 600


class Recorder:
    """Evaluates eq. 7 and the step of SMACOF, and records the value of each evaluation."""

    def __init__(self, distances: Array) -> None:
        self._gradient = StressGradient(distances, None, single=False, team=Team(1))
        self.count = len(distances)
        self.values: list[float] = []

    def __call__(self, axes: Array) -> tuple[float, Array]:
        """Return the value and half the gradient at a point."""
        value, gradient = self._gradient(axes)
        self.values.append(value)
        return value, gradient

    def step(self, axes: Array) -> tuple[float, Array]:
        """Return the value at a point and the next point of SMACOF."""
        value, gradient = self(axes)
        return value, axes - gradient / self.count

    @property
    def spent(self) -> bool:
        """Whether more than `MOST` evaluations were made."""
        return len(self.values) > MOST


def quasi_newton(function: Recorder, start: Array, memory: int) -> None:
    minimise(
        function, lambda axes: axes / function.count, start,
        memory=memory, decrease=0.0, evaluations=MOST, floor=1e-30,
    )  # fmt: skip


def extrapolated(function: Recorder, point: Array, cycle: int) -> None:
    """Minimise by reduced rank extrapolation of cycles of SMACOF (Rosman et al. 2008)."""
    value, target = function.step(point)
    while not function.spent:
        sequence = [point]
        for _ in range(cycle):
            point = target
            sequence.append(point)
            value, target = function.step(point)
        changes = np.stack([(b - a).ravel() for a, b in pairwise(sequence)])
        system = changes @ changes.T
        system += 1e-14 * np.trace(system) * np.eye(cycle)
        shares = np.linalg.solve(system, np.ones(cycle))
        combined = np.tensordot(shares / shares.sum(), sequence[1:], axes=1)
        new_value, new_target = function.step(combined)
        if new_value < value:
            point, value, target = combined, new_value, new_target


def anderson(function: Recorder, point: Array, memory: int) -> None:
    """Minimise by Anderson acceleration of SMACOF (Walker & Ni 2011), restarted when a step raises the stress."""
    value, target = function.step(point)
    residuals: list[Array] = []
    targets: list[Array] = []
    while not function.spent:
        new = target
        if residuals:
            system = np.stack([change.ravel() for change in residuals], axis=1)
            shares = np.linalg.lstsq(system, (target - point).ravel(), rcond=1e-10)[0]
            new = target - np.tensordot(shares, targets, axes=1)
        new_value, new_target = function.step(new)
        if new_value > value:
            if not residuals:
                return
            residuals.clear()
            targets.clear()
            continue
        residuals = [*residuals, (new_target - new) - (target - point)][-memory:]
        targets = [*targets, new_target - target][-memory:]
        point, value, target = new, new_value, new_target


SEARCHES: dict[str, Search] = {
    "SMACOF": partial(quasi_newton, memory=0),
    "RRE, cycles of 6": partial(extrapolated, cycle=6),
    "RRE, cycles of 10": partial(extrapolated, cycle=10),
    "Anderson, 5": partial(anderson, memory=5),
    "L-BFGS, 8 (ours)": partial(quasi_newton, memory=8),
    "L-BFGS, 20": partial(quasi_newton, memory=20),
}


def iterations_to(distances: Array, start: Array, shares: Sequence[float]) -> dict[str, list[float]]:
    """Return how many evaluations each search makes until it is within each of `shares` of the least stress found."""
    histories = {}
    for name, search in SEARCHES.items():
        function = Recorder(distances)
        search(function, np.ascontiguousarray((start - start.mean(axis=0)).T))
        histories[name] = np.minimum.accumulate(function.values[:MOST])
    least = min(history[-1] for history in histories.values())
    return {
        name: [
            next((made for made, value in enumerate(history) if value <= least * (1 + share)), np.inf)
            for share in shares
        ]
        for name, history in histories.items()
    }
