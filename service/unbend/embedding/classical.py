"""Classical scaling: the leading eigenvectors of the doubly centred squared distances (section 3.1)."""

from __future__ import annotations

import numpy as np
from scipy.linalg import eigh

from unbend.arrays import Floats


def classical_scaling(distances: Floats, dimensions: int) -> tuple[Floats, Floats]:
    """Embed by classical scaling.

    Parameters
    ----------
    distances : (n, n) float64
        Symmetric, plain (not squared) distances.
    dimensions : int

    Returns
    -------
    points : (n, dimensions) float64
        V L^(1/2) with the largest eigenvalues; columns whose eigenvalue is not positive, or for which there are
        too few points, are zero. Each column's largest entry is positive, so that runs agree.
    eigenvalues : (min(n, dimensions),) float64
        In falling order, negative ones included.
    """
    count = len(distances)
    inner = _double_centred(distances**2)  # eq. 4
    kept = min(count, dimensions)
    values, vectors = eigh(inner, subset_by_index=[count - kept, count - 1], overwrite_a=True, check_finite=False)
    values, vectors = values[::-1], vectors[:, ::-1]
    points = np.zeros((count, dimensions))
    points[:, :kept] = vectors * np.sqrt(np.maximum(values, 0.0))
    return points * _signs(points), values


def _double_centred(squared: Floats) -> Floats:
    means = squared.mean(axis=0)
    return np.asarray(-0.5 * (squared - means[:, None] - means[None, :] + means.mean()))


def _signs(points: Floats) -> Floats:
    largest = points[np.abs(points).argmax(axis=0), np.arange(points.shape[1])]
    return np.where(largest < 0, -1.0, 1.0)
