"""Classical scaling: the leading eigenvectors of the doubly centred squared distances (section 3.1)."""

from __future__ import annotations

import numpy as np
from scipy.linalg import eigh

from unbend.arrays import Floats
from unbend.embedding.fast import fastmap
from unbend.embedding.krylov import is_worthwhile, leading_eigenpairs


def classical_scaling(distances: Floats, dimensions: int, weights: Floats | None = None) -> tuple[Floats, Floats]:
    """Embed by classical scaling.

    Parameters
    ----------
    distances : (n, n) float64
        Symmetric, plain (not squared) distances.
    dimensions : int
    weights : (n,) float64, optional
        Weight of each point, above 0, such as the area it represents. Equal by default.

    Returns
    -------
    points : (n, dimensions) float64
        V L^(1/2) for the largest eigenvalues, centred with the weights. A column is zero if its eigenvalue is not
        positive, or if there are too few points. The entry of largest magnitude in each column is positive, so that all
        runs give the same points.
    eigenvalues : (min(n, dimensions),) float64
        In falling order, including negative ones. With weights, the eigenvalues of W^(1/2) B W^(1/2), where W is scaled
        to a mean of 1.
    """
    count = len(distances)
    kept = min(count, dimensions)
    shares = np.full(count, 1 / count) if weights is None else weights / weights.sum()
    roots = np.sqrt(shares * count)
    squared = distances**2
    found = None
    if is_worthwhile(count, kept):
        start = fastmap(distances, kept)[0]  # the axes of FastMap span nearly the same space
        found = leading_eigenpairs(lambda columns: _inner_times(squared, shares, roots, columns), start)
    if found is None:
        inner = roots[:, None] * inner_products(squared, shares) * roots
        values, vectors = eigh(inner, subset_by_index=[count - kept, count - 1], overwrite_a=True, check_finite=False)
        found = values[::-1], vectors[:, ::-1]
    values, vectors = found
    points = np.zeros((count, dimensions))
    points[:, :kept] = vectors * np.sqrt(np.maximum(values, 0.0)) / roots[:, None]
    return points * _signs(points), values


def inner_products(squared: Floats, shares: Floats) -> Floats:
    """Return B of eq. 4 from squared distances, centred with `shares` (n,), which sum to 1."""
    means = squared @ shares
    return np.asarray(-0.5 * (squared - means[:, None] - means[None, :] + shares @ means))


def _inner_times(squared: Floats, shares: Floats, roots: Floats, columns: Floats) -> Floats:
    """Multiply `columns` by W^(1/2) B W^(1/2) without forming that matrix."""
    weighted = roots[:, None] * columns
    weighted = weighted - shares[:, None] * weighted.sum(axis=0)  # the transposed centring
    product = squared @ weighted
    product -= shares @ product
    return np.asarray(-0.5 * roots[:, None] * product)


def _signs(points: Floats) -> Floats:
    """Return the sign of the entry of largest magnitude in each column, (m,)."""
    largest = points[np.abs(points).argmax(axis=0), np.arange(points.shape[1])]
    return np.where(largest < 0, -1.0, 1.0)
