"""`embed`: the public function for all three scaling methods, which checks its arguments."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, Literal, TypeGuard, get_args

import numpy as np
from numpy.typing import ArrayLike

from unbend.arrays import Floats, frozen
from unbend.brief import brief, counted_points, noted
from unbend.embedding.checks import (
    check_distances,
    check_pair_weights,
    check_point_weights,
    rescaled,
    scaled_to_range,
)
from unbend.embedding.classical import classical_scaling
from unbend.embedding.dimension import MAX_DIMENSIONS, effective_dimension
from unbend.embedding.fast import fastmap
from unbend.embedding.least_squares import Progress, smacof
from unbend.embedding.starts import low_starts, random_points
from unbend.embedding.stress import stress
from unbend.errors import ParameterError, check_choice
from unbend.threads import check_threads, one_blas_thread
from unbend.tolerances import REPRESENTATION_ERROR, SMACOF_ITERATIONS

Method = Literal["classical", "least_squares", "fast"]

Criterion = Literal["error", "stress"]

AUTO: Final = "auto"

MAX_STARTS: Final = 20
"""Upper bound of `Parameters.starts`. `embed` accepts larger numbers."""

_TRIED_ITERATIONS: Final = 8
"""Iterations from the classical solution and each of `low_starts`; only the one of lowest stress then continues."""


@dataclass(frozen=True, eq=False)
class Embedding:
    """Points in a Euclidean space whose distances approximate the given distances."""

    points: Floats  # (n, m)
    stress: float
    """Eq. 2 of exactly these points."""
    iterations: int
    """Iterations of SMACOF, from all starts; 0 for the other methods."""
    eigenvalues: Floats
    """Leading eigenvalues of classical scaling, (min(n, m),); empty for "fast".

    They are in squared units of the distances. Outside the range of double precision they are infinite or 0.
    """
    clipped: int = 0
    """Number of negative squared residuals that FastMap replaced by zero."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", frozen(self.points, np.float64))
        object.__setattr__(self, "eigenvalues", frozen(self.eigenvalues, np.float64))

    def __repr__(self) -> str:
        return brief(
            self, counted_points(self.points.shape), f"stress {self.stress:.3g}", noted(self.iterations, "iteration")
        )


def embed(
    distances: ArrayLike,
    dimensions: int | Literal["auto"] = 3,
    *,
    method: Method = "least_squares",
    weights: ArrayLike | None = None,
    starts: int = 0,
    seed: int = 0,
    criterion: Criterion = "error",
    threshold: float = REPRESENTATION_ERROR,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Embedding:
    """Embed points in `dimensions` dimensions so that their distances approximate the given distances.

    Parameters
    ----------
    distances : (n, n) array
        Symmetric, finite, not negative, zero on the diagonal; plain distances, not squared.
    dimensions : int or "auto", default 3
        "auto" takes the least number, up to 12, for which `criterion` is at most `threshold`.
    method : {"least_squares", "classical", "fast"}
        "least_squares" is accelerated SMACOF. It starts from the classical solution, or from one of the best
        arrangements of a few points, extended to all points, whichever has the lowest stress after a few iterations.
        "classical" is classical scaling, and "fast" is FastMap, which needs the fewest operations. The stress of
        "least_squares" is never above that of the other methods.
    weights : (n, n) or (n,) array, optional
        Weights of pairs or of points. Weights of pairs, the w_ij of eq. 2, require "least_squares". They must be
        symmetric and not negative, and connect all points. Weights of points, such as the area that each represents,
        require "classical" or "least_squares" and must be above zero. For "least_squares", w_ij is then the product of
        both points' weights, each divided by the mean weight.
    starts : int, default 0
        Additional starts of "least_squares", with all points at random places. The result of lowest stress is returned.
    seed : int, default 0
        Seed of the random places, not negative. The same seed gives the same points on every run.
    criterion : {"error", "stress"}
        Criterion for `dimensions` "auto": the representation error of eq. 6, as in `effective_dimension`, or the stress
        of eq. 2 with this method.
    threshold : float, default 0.05
        Largest value of the criterion, above 0 and below 1.
    threads : int, optional
        All cores by default. The result does not depend on it.
    progress : callable, optional
        Called after each iteration of "least_squares" with its number, counted over all starts, and the lowest stress
        so far.

    Returns
    -------
    Embedding
        Deterministic; defined up to rotation and reflection.

    Raises
    ------
    ParameterError
        If an argument is not as described.

    Examples
    --------
    >>> triangle = [[0, 3, 5], [3, 0, 4], [5, 4, 0]]
    >>> found = embed(triangle, 2)
    >>> round(float(np.linalg.norm(found.points[0] - found.points[2])), 6)
    5.0
    """
    matrix, power = scaled_to_range(check_distances(distances))
    check_choice("method", method, get_args(Method))
    if not _is_count(starts) or (starts and method != "least_squares"):
        raise ParameterError(f"starts must be a whole number from 0, and 0 except for least_squares, not {starts!r}")
    if not _is_count(seed):
        raise ParameterError(f"seed must be a whole number from 0, not {seed!r}")
    check_threads(threads)
    pairs, shares = _checked_weights(weights, method, len(matrix))
    pairs, weight_power = (None, 0) if pairs is None else scaled_to_range(pairs)
    problem = _Problem(matrix, method, pairs, shares, starts, seed, threads, progress)
    if dimensions != AUTO and not (_is_count(dimensions) and dimensions > 0):
        raise ParameterError(f'dimensions must be a whole number from 1, or "auto", not {dimensions!r}')
    with one_blas_thread(len(matrix)):
        automatic = dimensions == AUTO
        found = _fewest(problem, criterion, threshold) if automatic else _embedded(problem, int(dimensions))
    return replace(
        found,
        points=rescaled(found.points, power),
        stress=float(rescaled(found.stress, weight_power)),
        eigenvalues=rescaled(found.eigenvalues, 2 * power),
    )


@dataclass(frozen=True, eq=False)
class _Problem:
    """The checked arguments of `embed`."""

    matrix: Floats
    method: Method
    pairs: Floats | None
    shares: Floats | None
    starts: int
    seed: int
    threads: int | None
    progress: Progress | None


def _fewest(problem: _Problem, criterion: Criterion, threshold: float) -> Embedding:
    """Embed in the least number of dimensions for which the criterion is at most the threshold, up to the maximum."""
    check_choice("criterion", criterion, get_args(Criterion))
    if criterion == "error":
        return _embedded(problem, effective_dimension(problem.matrix, error=threshold))
    if not 0 < threshold < 1:
        raise ParameterError(f"threshold must lie between 0 and 1, not {threshold!r}")
    for dimensions in range(1, MAX_DIMENSIONS + 1):
        found = _embedded(problem, dimensions)
        if found.stress <= threshold:
            break
    return found


def _embedded(problem: _Problem, dimensions: int) -> Embedding:
    matrix, method = problem.matrix, problem.method
    if method == "fast":
        points, clipped = fastmap(matrix, dimensions)
        return Embedding(points, stress(points, matrix), 0, np.empty(0), clipped=clipped)
    points, eigenvalues = classical_scaling(matrix, dimensions, problem.shares)
    if method == "classical":
        return Embedding(points, stress(points, matrix), 0, eigenvalues)
    return replace(_least_squares(problem, points), eigenvalues=eigenvalues)


def _least_squares(problem: _Problem, classical: Floats) -> Embedding:
    matrix, pairs, dimensions = problem.matrix, problem.pairs, classical.shape[1]
    made = 0
    lowest = np.inf

    def report(_: int, value: float) -> None:
        nonlocal made, lowest
        made, lowest = made + 1, min(lowest, value)
        if problem.progress is not None:
            problem.progress(made, lowest)

    def scaled(start: Floats, iterations: int = SMACOF_ITERATIONS) -> Embedding:
        points, _ = smacof(matrix, start, pairs, iterations=iterations, threads=problem.threads, progress=report)
        return Embedding(points, stress(points, matrix, pairs), 0, np.empty(0))

    low = low_starts(matrix, classical, pairs, problem.seed)
    tried = [scaled(start, _TRIED_ITERATIONS) for start in (classical, *low)]
    found = [scaled(min(tried, key=_stress_of).points)]
    found += [scaled(start) for start in random_points(matrix, dimensions, problem.starts, problem.seed)]
    best = min(found, key=_stress_of)
    for other in (classical, fastmap(matrix, dimensions)[0]):  # ensures that no other method has a lower stress
        if stress(other, matrix, pairs) < best.stress:
            best = min(best, scaled(other), key=_stress_of)
    return replace(best, iterations=made)


def _stress_of(embedding: Embedding) -> float:
    return embedding.stress


def _is_count(value: object) -> TypeGuard[int]:
    return isinstance(value, int | np.integer) and not isinstance(value, bool) and bool(value >= 0)


def _checked_weights(weights: ArrayLike | None, method: Method, count: int) -> tuple[Floats | None, Floats | None]:
    """Return the weights of pairs for least squares, and the weights of points for classical scaling."""
    if weights is None:
        return None, None
    if np.ndim(weights) == 1 and method != "fast":
        points = check_point_weights(weights, count)
        return np.outer(points, points), points
    pairs = check_pair_weights(weights, count)
    if method != "least_squares":
        raise ParameterError(f"weights of pairs go with least_squares only, not with {method}")
    return pairs, None
