"""Least squares scaling: SMACOF, iterative majorisation of the stress (section 3.2; Borg & Groenen, ch. 8).

The paper prints the diagonal of B(Z) with the wrong sign, and the stopping rule without the decrease. This code follows
Borg & Groenen in both. A step of SMACOF is a gradient step in the metric of V, X - V^+ (V X - B(X) X), so quasi-Newton
steps in that metric accelerate the search.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from unbend.arrays import Floats
from unbend.embedding.gradient import StressGradient, team_for
from unbend.embedding.quasi_newton import minimise
from unbend.errors import ParameterError
from unbend.tolerances import SINGLE_STRESS, SMACOF_DECREASE, SMACOF_ITERATIONS, SMACOF_MEMORY, ZERO_STRESS

Progress = Callable[[int, float], None]
"""Callback that receives the number of an iteration and the stress after it."""


def smacof(
    distances: Floats,
    start: Floats,
    weights: Floats | None = None,
    *,
    memory: int = SMACOF_MEMORY,
    decrease: float = SMACOF_DECREASE,
    iterations: int = SMACOF_ITERATIONS,
    threads: int | None = None,
    progress: Progress | None = None,
) -> tuple[Floats, int]:
    """Lower the stress of `start` until iterations lower it by less than the share `decrease`.

    Parameters
    ----------
    distances : (n, n) float64
    start : (n, m) float64
        Initial points. The classical solution is a good choice.
    weights : (n, n) float64, optional
        Symmetric and not negative; ones by default. The pairs with a positive weight must connect all points.
    memory : int
        Number of steps that limited-memory BFGS uses to accelerate the search. 0 is plain SMACOF, as in the paper.
    decrease : float
        Share of the stress. The search ends after two successive iterations with smaller decreases.
    iterations : int
        Maximum number of iterations.
    threads : int, optional
        All cores by default. The result does not depend on it.
    progress : callable, optional
        Called after each iteration with its number and the stress.

    Returns
    -------
    points : (n, m) float64
        The last configuration; its stress is never above that of `start`.
    iterations : int
        Number of iterations, each of which evaluates B(X) X once.

    Raises
    ------
    ParameterError
        If the weights differ by more orders of magnitude than double precision can represent.
    """
    if weights is not None:
        # Neither a common factor nor equal weights change the minimum.
        weights = None if are_equal(weights) else weights / weights.max()
    inverse = _laplacian_inverse(weights, len(distances))
    axes, made = np.ascontiguousarray((start - start.mean(axis=0)).T), 0
    with team_for(len(distances), threads) as team:
        for single, floor in ((True, SINGLE_STRESS), (False, ZERO_STRESS)):
            report = None if progress is None else _counted_from(made, progress)
            function = StressGradient(distances, weights, single=single, team=team)
            found = minimise(
                function, inverse, axes,
                memory=memory, decrease=decrease, evaluations=iterations - made, floor=floor,
                progress=report,
            )  # fmt: skip
            axes, made = found.point, made + found.evaluations
            if found.value > floor:
                break
    return np.ascontiguousarray(axes.T), made


def _counted_from(made: int, progress: Progress) -> Progress:
    return lambda count, stress: progress(made + count, stress)


def are_equal(weights: Floats) -> bool:
    """Return whether all pairs have equal weights. The diagonal is ignored."""
    pairs = weights[~np.eye(len(weights), dtype=bool)]
    return len(pairs) == 0 or bool(np.ptp(pairs) == 0)


def _laplacian_inverse(weights: Floats | None, count: int) -> Callable[[Floats], Floats]:
    """Return a function that multiplies centred columns, (m, n), by V^+ of eq. 8."""
    if weights is None:
        return lambda axes: axes / count  # eq. 9
    laplacian = np.diag(weights.sum(axis=1)) - weights
    laplacian += laplacian.trace() / count**2  # makes it definite and keeps its inverse on centred columns
    try:
        factor = cho_factor(laplacian, overwrite_a=True, check_finite=False)
    except np.linalg.LinAlgError:
        raise ParameterError(
            "the weights differ by too many orders of magnitude: in double precision they do not connect all points"
        ) from None
    return lambda axes: np.ascontiguousarray(cho_solve(factor, axes.T, check_finite=False).T)
