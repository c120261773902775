"""Functions on a surface from geodesic distances: a spectral basis, and coordinates of classical scaling."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.linalg import eigh

from unbend.arrays import Floats, Indices, Singles

WIDTH: Final = 0.1
"""Width of the Gaussian steps over the square root of the area: about two radii of 300 samples."""

SCALING_AXES: Final = 4
"""Coordinates of classical scaling. The fourth separates legs that three coordinates confuse."""

_FLOOR: Final = 1e-12


def basis(rows: Singles, samples: Indices, weights: Floats, count: int) -> tuple[Floats, Floats]:
    """Return the smoothest functions on a surface, and their masses at the samples.

    They are the leading eigenvectors of a random walk with Gaussian steps on the samples, corrected for their density
    (Coifman & Lafon 2006, alpha = 1; `unbend.descriptors.spectrum`), extended to all vertices by Nyström's formula.
    They approximate the eigenfunctions of the Laplace-Beltrami operator, but need no good triangles.

    Parameters
    ----------
    rows : (S, n) float32
        Geodesic distances from each sample to every vertex, on a surface of area 1.
    samples : (S,) int64
    weights : (S,) float64
        Share of the area of each sample.
    count : int
        Most functions. There are at most half as many as samples.

    Returns
    -------
    functions : (n, k) float64
        The first is constant. They are orthonormal under `masses` at the samples.
    masses : (S,) float64
        They sum to 1.
    """
    steps = np.exp(-((rows.astype(np.float64) / WIDTH) ** 2))
    density = np.maximum(weights @ steps, _FLOOR)
    steps /= density[samples][:, None] * density
    degree = np.maximum(weights @ steps, _FLOOR)
    steps /= np.sqrt(degree[samples][:, None] * degree)
    kept = max(min(count, len(samples) // 2), min(len(samples), 2))
    root = np.sqrt(weights)
    values, vectors = _leading(root[:, None] * steps[:, samples] * root, kept)
    extended = (steps.T * root) @ (vectors / np.maximum(values, _FLOOR)) / np.sqrt(degree)[:, None]
    masses = weights * degree[samples]
    extended *= np.sqrt(masses.sum())
    return extended, masses / masses.sum()


def scaling(rows: Singles, samples: Indices, weights: Floats) -> Floats:
    """Return the canonical form by classical scaling with area weights, extended to all vertices, (n, 4).

    Section 3.1 of Elad & Kimmel; Nyström's formula places the other vertices (de Silva & Tenenbaum 2004).
    """
    squared = rows.astype(np.float64) ** 2
    between = (squared[:, samples] + squared[:, samples].T) / 2
    means, every = weights @ between, weights @ squared
    root = np.sqrt(weights)
    inner = -0.5 * (between - means[:, None] - means + weights @ means)
    kept = min(SCALING_AXES, len(samples))
    values, vectors = _leading(root[:, None] * inner * root, kept)
    crossed = -0.5 * (squared - means[:, None] - every + weights @ means)
    points = np.zeros((rows.shape[1], SCALING_AXES))
    points[:, :kept] = (crossed.T * root) @ vectors / np.sqrt(np.maximum(values, _FLOOR))
    points[:, :kept][:, values <= _FLOOR] = 0.0
    return points


def _leading(matrix: Floats, count: int) -> tuple[Floats, Floats]:
    size = len(matrix)
    values, vectors = eigh((matrix + matrix.T) / 2, subset_by_index=[size - count, size - 1], check_finite=False)
    return values[::-1], vectors[:, ::-1]
