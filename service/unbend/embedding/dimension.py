"""The effective dimension of distances, by the representation error of classical scaling (section 3.1)."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from unbend.arrays import Floats
from unbend.embedding.checks import check_distances, scaled_to_range
from unbend.embedding.classical import inner_products
from unbend.errors import ParameterError
from unbend.tolerances import REPRESENTATION_ERROR

MAX_DIMENSIONS: Final = 12
"""The largest effective dimension that is reported."""


def representation_errors(distances: ArrayLike) -> Floats:
    """Representation error of classical scaling in 1, 2, ... n dimensions.

    Parameters
    ----------
    distances : (n, n) array
        Symmetric, finite, not negative, zero on the diagonal.

    Returns
    -------
    (n,) float64
        Eq. 6, relative: the root of sum_{i > m} lambda_i^2 / sum_i lambda_i^2 over the positive eigenvalues of B
        (eq. 4). For geodesic distances B also has negative eigenvalues, which no Euclidean space represents. The error
        falls with m. The share of energy captured is 1 minus the square of the error.

    Raises
    ------
    ParameterError
        If `distances` is not as described.

    Examples
    --------
    >>> representation_errors([[0, 3, 5], [3, 0, 4], [5, 4, 0]]).round(2).tolist()
    [0.27, 0.0, 0.0]
    """
    matrix, _ = scaled_to_range(check_distances(distances))  # the errors are ratios, so the unit does not matter
    count = len(matrix)
    values = np.linalg.eigvalsh(inner_products(matrix**2, np.full(count, 1 / count)))
    squares = np.maximum(values, 0.0) ** 2  # rising
    left = np.concatenate([[0.0], np.cumsum(squares)])[:count][::-1]
    return np.asarray(np.sqrt(left / squares.sum()) if squares.sum() > 0 else np.zeros(count))


def effective_dimension(
    distances: ArrayLike, *, error: float = REPRESENTATION_ERROR, most: int = MAX_DIMENSIONS
) -> int:
    """Fewest dimensions in which classical scaling has a representation error of at most `error`.

    Parameters
    ----------
    distances : (n, n) array
    error : float, default 0.05
        Above 0 and below 1; the default is the paper's 5 %.
    most : int, default 12
        Upper bound of the result.

    Returns
    -------
    int
        At most `most`. It is itself a bending invariant (section 3): 2 for developable sheets, mostly 3 or more for
        closed surfaces.

    Raises
    ------
    ParameterError
        If an argument is not as described.

    Examples
    --------
    >>> effective_dimension([[0, 3, 5], [3, 0, 4], [5, 4, 0]])
    2
    """
    if not 0 < error < 1 or most < 1:
        raise ParameterError(f"error must lie between 0 and 1, and most must be at least 1, not {error!r} and {most!r}")
    small = np.flatnonzero(representation_errors(distances) <= error)
    return int(min(most, small[0] + 1))
