"""Validation of distances and weights, and scaling that keeps their powers within double precision."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from unbend.arrays import Floats
from unbend.errors import ParameterError
from unbend.tolerances import SYMMETRY

_LARGEST_POWER: Final = 200  # exponent of two: sums of fourth powers must stay below 2^1024


def check_distances(distances: ArrayLike) -> Floats:
    """Return a valid distance matrix as float64, or raise ParameterError."""
    matrix = _square(distances, "distances")
    if not np.isfinite(matrix).all():
        row, column = np.argwhere(~np.isfinite(matrix))[0]
        raise ParameterError(f"distances[{row}, {column}] is {matrix[row, column]}: embed one component at a time")
    _check_symmetry(matrix, "distances")
    if matrix.min() < 0:
        raise ParameterError(f"a distance is negative: {matrix.min()}")
    if np.diagonal(matrix).any():
        raise ParameterError("the diagonal of distances must be zero")
    return matrix


def check_pair_weights(weights: ArrayLike, count: int) -> Floats:
    """Return weights of pairs as (n, n) float64, or raise ParameterError."""
    matrix = _square(weights, "weights")
    if len(matrix) != count:
        raise ParameterError(f"weights must be {(count, count)} like distances, not {matrix.shape}")
    if not np.isfinite(matrix).all() or matrix.min() < 0:
        raise ParameterError("weights must be finite and not negative")
    _check_symmetry(matrix, "weights")
    if connected_components(csr_array(matrix), directed=False)[0] > 1:
        raise ParameterError("the pairs with a weight must connect all points")
    return matrix


def check_point_weights(weights: ArrayLike, count: int) -> Floats:
    """Return weights of points as (n,) float64 with a mean of 1, or raise ParameterError."""
    vector = np.array(weights, np.float64)
    if vector.shape != (count,):
        raise ParameterError(f"weights of points must be {(count,)}, not {vector.shape}")
    if not np.isfinite(vector).all() or vector.min() <= 0:
        raise ParameterError("weights of points must be finite and above zero")
    vector = vector / vector.max()  # the sum of the given weights may be too large
    return np.asarray(vector / vector.mean())


def scaled_to_range(matrix: Floats) -> tuple[Floats, int]:
    """Divide `matrix` by a power of two, so that fourth powers are in the range of double precision.

    Return the result and the exponent. The exponent is 0 if the matrix needs no scaling.
    """
    power = int(np.frexp(matrix.max())[1])
    return (matrix, 0) if abs(power) <= _LARGEST_POWER else (np.ldexp(matrix, -power), power)


def rescaled(values: ArrayLike, power: int) -> Floats:
    """Return `values` times two to the `power`: infinite, or 0, outside the range of double precision."""
    with np.errstate(over="ignore", under="ignore"):
        return np.asarray(np.ldexp(values, power))


def _square(values: ArrayLike, what: str) -> Floats:
    matrix = np.ascontiguousarray(values, np.float64)
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or len(matrix) == 0:
        raise ParameterError(f"{what} must be a square matrix, not of shape {matrix.shape}")
    return matrix


def _check_symmetry(matrix: Floats, what: str) -> None:
    if np.abs(matrix - matrix.T).max() > SYMMETRY * np.abs(matrix).max():
        raise ParameterError(f"{what} must be symmetric")
