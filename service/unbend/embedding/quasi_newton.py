"""Limited-memory BFGS (Nocedal 1980; Nocedal & Wright, alg. 7.4), in the metric of a given Hessian."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from unbend.arrays import Floats

Function = Callable[[Floats], tuple[float, Floats]]
Inverse = Callable[[Floats], Floats]

_SMALL_GAINS: Final = 2  # one step may gain little before others gain much


@dataclass(frozen=True, eq=False)
class Minimum:
    """Where a search ended."""

    point: Floats
    value: float
    evaluations: int
    """Of the function, without that of the start."""


@dataclass(frozen=True, eq=False)
class _Pair:
    step: Floats
    change: Floats  # of the gradient
    curvature: float  # step . change, above 0


def minimise(
    function: Function,
    inverse: Inverse,
    start: Floats,
    *,
    memory: int,
    decrease: float,
    evaluations: int,
    floor: float,
) -> Minimum:
    """Lower `function` from `start` on; it never rises.

    Parameters
    ----------
    function : callable
        Returns the value and the gradient of a point.
    inverse : callable
        Applies the inverse of a Hessian that is nowhere below the true one, so that -inverse(gradient) is a step
        that never raises the value: for eq. 7 the step of SMACOF (eq. 8).
    start : array
    memory : int
        Pairs of steps and gradients kept. With 0 every step is -inverse(gradient).
    decrease : float
        Share of the value: the search ends when two steps in a row gain less.
    evaluations : int
        Most evaluations made after the first.
    floor : float
        A value that is low enough.
    """
    point = start
    value, gradient = function(point)
    pairs: deque[_Pair] = deque(maxlen=memory)
    made = small = 0
    while made < evaluations and value > floor and small < _SMALL_GAINS:
        step = -_direction(gradient, pairs, inverse)
        new_value, new_gradient = function(point + step)
        made += 1
        if not new_value < value:
            if not pairs:
                break  # rounding: not even the safe step gains
            pairs.clear()
            continue
        small = small + 1 if value - new_value <= decrease * value else 0
        change = new_gradient - gradient
        curvature = float(np.vdot(step, change))
        if curvature > 0.0:
            pairs.append(_Pair(step, change, curvature))
        point, value, gradient = point + step, new_value, new_gradient
    return Minimum(point, value, made)


def _direction(gradient: Floats, pairs: deque[_Pair], inverse: Inverse) -> Floats:
    """Multiply the gradient by the approximate inverse of the Hessian, in two loops."""
    if not pairs:
        return inverse(gradient)
    rest, shares = gradient, []
    for pair in reversed(pairs):
        share = float(np.vdot(pair.step, rest)) / pair.curvature
        rest = rest - share * pair.change
        shares.append(share)
    last = pairs[-1]
    scale = last.curvature / float(np.vdot(last.change, inverse(last.change)))
    result = scale * inverse(rest)
    for pair, share in zip(pairs, reversed(shares), strict=True):
        result = result + (share - float(np.vdot(pair.change, result)) / pair.curvature) * pair.step
    return result
