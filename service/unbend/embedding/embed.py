"""The checked entrance to the three methods."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from unbend.arrays import Floats, frozen
from unbend.embedding.classical import classical_scaling
from unbend.embedding.fast import fastmap
from unbend.embedding.least_squares import smacof
from unbend.embedding.stress import stress
from unbend.errors import ParameterError

Method = Literal["classical", "least_squares", "fast"]


@dataclass(frozen=True, eq=False)
class Embedding:
    """Points in a Euclidean space whose distances stand for those given."""

    points: Floats  # (n, m)
    stress: float
    """Eq. 2, of exactly these points."""
    iterations: int
    """Of SMACOF; 0 for the other methods."""
    eigenvalues: Floats
    """Leading eigenvalues of classical scaling, (min(n, m),); empty for "fast"."""
    clipped: int = 0
    """Negative squared residuals that FastMap took for zero."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", frozen(self.points, np.float64))
        object.__setattr__(self, "eigenvalues", frozen(self.eigenvalues, np.float64))


def embed(
    distances: ArrayLike,
    dimensions: int = 3,
    *,
    method: Method = "least_squares",
    weights: ArrayLike | None = None,
) -> Embedding:
    """Embed points in `dimensions` dimensions so that their distances are near those given.

    Parameters
    ----------
    distances : (n, n) array
        Symmetric, finite, not negative, zero on the diagonal; plain distances, not squared.
    dimensions : int, default 3
    method : {"least_squares", "classical", "fast"}
        SMACOF from the classical solution (lowest stress), classical scaling, or FastMap (fewest operations).
    weights : (n, n) array, optional
        w_ij of eq. 2 for "least_squares": symmetric, not negative, connecting all points.

    Returns
    -------
    Embedding
        Deterministic; defined up to rotation and reflection.

    Raises
    ------
    ParameterError
        If an argument is not as described.
    """
    matrix = _checked_distances(distances)
    if dimensions < 1 or dimensions != int(dimensions):
        raise ParameterError(f"dimensions must be a whole number from 1, not {dimensions!r}")
    if method not in get_args(Method):
        raise ParameterError(f"method must be one of {get_args(Method)}, not {method!r}")
    w = None if weights is None else _checked_weights(weights, len(matrix))
    if w is not None and method != "least_squares":
        raise ParameterError(f"weights go with least_squares only, not with {method}")
    if method == "fast":
        points, clipped = fastmap(matrix, dimensions)
        return Embedding(points, stress(points, matrix), 0, np.empty(0), clipped)
    points, eigenvalues = classical_scaling(matrix, dimensions)
    iterations = 0
    if method == "least_squares":
        points, iterations = smacof(matrix, points, w)
    return Embedding(points, stress(points, matrix, w), iterations, eigenvalues)


def _checked_distances(distances: ArrayLike) -> Floats:
    matrix = _square(distances, "distances")
    if not np.isfinite(matrix).all():
        row, column = np.argwhere(~np.isfinite(matrix))[0]
        raise ParameterError(f"distances[{row}, {column}] is {matrix[row, column]}: embed one component at a time")
    if matrix.min() < 0:
        raise ParameterError(f"a distance is negative: {matrix.min()}")
    if np.diagonal(matrix).any():
        raise ParameterError("the diagonal of distances must be zero")
    return matrix


def _checked_weights(weights: ArrayLike, count: int) -> Floats:
    matrix = _square(weights, "weights")
    if len(matrix) != count:
        raise ParameterError(f"weights must be {(count, count)} like distances, not {matrix.shape}")
    if not np.isfinite(matrix).all() or matrix.min() < 0:
        raise ParameterError("weights must be finite and not negative")
    if connected_components(csr_array(matrix), directed=False)[0] > 1:
        raise ParameterError("the pairs with a weight must connect all points")
    return matrix


def _square(values: ArrayLike, what: str) -> Floats:
    matrix = np.ascontiguousarray(values, np.float64)
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or len(matrix) == 0:
        raise ParameterError(f"{what} must be a square matrix, not of shape {matrix.shape}")
    if not np.allclose(matrix, matrix.T, rtol=1e-9, atol=0, equal_nan=True):
        raise ParameterError(f"{what} must be symmetric")
    return matrix
