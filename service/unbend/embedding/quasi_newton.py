"""Limited-memory BFGS (Nocedal 1980; Nocedal & Wright, alg. 7.4), in the metric of a given Hessian."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from unbend.arrays import Floats
from unbend.jit import kernel

Function = Callable[[Floats], tuple[float, Floats]]
Inverse = Callable[[Floats], Floats]

_SMALL_GAINS: Final = 2  # successive small decreases that end the search; a single one may precede larger ones


@dataclass(frozen=True, eq=False)
class Minimum:
    """The result of a minimisation."""

    point: Floats
    value: float
    evaluations: int
    """Number of evaluations of the function, without the evaluation at the start."""


def minimise(
    function: Function,
    inverse: Inverse,
    start: Floats,
    *,
    memory: int,
    decrease: float,
    evaluations: int,
    floor: float,
    progress: Callable[[int, float], None] | None = None,
) -> Minimum:
    """Minimise `function` from `start`. The value never rises.

    Parameters
    ----------
    function : callable
        Returns the value and the gradient of a point.
    inverse : callable
        Applies the inverse of an upper bound of the Hessian, so that the step -inverse(gradient) never raises the
        value. For eq. 7 this is the step of SMACOF (eq. 8).
    start : (m, n) array
    memory : int
        Number of stored steps with their changes of the gradient. With 0 every step is -inverse(gradient).
    decrease : float
        Share of the value. The search ends when two successive steps lower the value by less.
    evaluations : int
        Maximum number of evaluations after the first.
    floor : float
        The search ends at a value that is not above this one.
    progress : callable, optional
        Called after each evaluation with the number of evaluations so far and the lowest value.
    """
    point = start
    value, gradient = function(point)
    history = _History(memory, start.shape)
    made = small = 0
    while made < evaluations and value > floor and small < _SMALL_GAINS:
        step = -history.direction(gradient, inverse)
        new_value, new_gradient = function(point + step)
        made += 1
        if progress:
            progress(made, min(value, new_value))
        if not new_value < value:
            if history.size == 0:
                break  # rounding: even the safe step does not lower the value
            history.size = 0
            continue
        small = small + 1 if value - new_value <= decrease * value else 0
        history.add(step, new_gradient - gradient)
        point, value, gradient = point + step, new_value, new_gradient
    return Minimum(point, value, made)


class _History:
    """The last steps, and the change of the gradient in each."""

    def __init__(self, memory: int, shape: tuple[int, ...]) -> None:
        self.size = 0
        self._steps, self._changes = np.empty((2, memory, *shape))
        self._curvatures = np.empty(memory)  # step . change

    def add(self, step: Floats, change: Floats) -> None:
        """Store a step if its curvature is positive. If the memory is full, it replaces the oldest step."""
        memory, curvature = len(self._curvatures), float(np.vdot(step, change))
        if memory == 0 or curvature <= 0.0:
            return
        if self.size == memory:
            for rows in (self._steps, self._changes, self._curvatures):
                rows[:-1] = rows[1:]
        self.size = min(self.size + 1, memory)
        newest = self.size - 1
        self._steps[newest], self._changes[newest], self._curvatures[newest] = step, change, curvature

    def direction(self, gradient: Floats, inverse: Inverse) -> Floats:
        """Multiply the gradient by the approximate inverse of the Hessian, with the two-loop recursion."""
        if self.size == 0:
            return inverse(gradient)
        steps, changes = self._steps[: self.size], self._changes[: self.size]
        curvatures = self._curvatures[: self.size]
        result, shares = gradient.copy(), np.empty(self.size)
        _from_the_newest(steps, changes, curvatures, result, shares)
        last = changes[-1]
        result = np.ascontiguousarray(curvatures[-1] / np.vdot(last, inverse(last)) * inverse(result))
        _from_the_oldest(steps, changes, curvatures, result, shares)
        return result


@kernel
def _dot(a, b):
    total = 0.0
    for axis in range(len(a)):
        for index in range(a.shape[1]):
            total += a[axis, index] * b[axis, index]
    return total


@kernel
def _add_multiple(factor, rows, result):
    for axis in range(len(rows)):
        for index in range(rows.shape[1]):
            result[axis, index] += factor * rows[axis, index]


@kernel
def _from_the_newest(steps, changes, curvatures, result, shares):
    for pair in range(len(steps) - 1, -1, -1):
        shares[pair] = _dot(steps[pair], result) / curvatures[pair]
        _add_multiple(-shares[pair], changes[pair], result)


@kernel
def _from_the_oldest(steps, changes, curvatures, result, shares):
    for pair in range(len(steps)):
        _add_multiple(shares[pair] - _dot(changes[pair], result) / curvatures[pair], steps[pair], result)
