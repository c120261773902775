"""Geodesic spectrum (Smeets et al., "Isometric deformation invariant 3D shape recognition", 2012: SD-GDM)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
from scipy.linalg import eigvalsh

from unbend.arrays import Floats
from unbend.tolerances import SPECTRUM_FLOOR

_KERNELS: Final[tuple[tuple[Callable[[Floats], Floats], int], ...]] = (
    (lambda d: np.exp(-d), 60),
    (lambda d: np.sqrt(d * np.sqrt(d)), 60),  # d^0.75, without a logarithm for each
    (lambda d: d, 40),
)
"""Functions of the distance, and how many eigenvalues of each are kept."""


def geodesic_spectrum(distances: Floats, weights: Floats) -> Floats:
    """Return the logarithms of the largest eigenvalues of the area-weighted distance matrix, under three kernels.

    For a kernel f these are the eigenvalues of diag(sqrt w) f(D) diag(sqrt w), by magnitude, which approximate
    those of the operator that averages f(d(x, .)) over the surface: they depend on no order of the samples and,
    as the samples grow denser, on no particular samples. Differences of logarithms under the three kernels are
    of one size on real shapes, so that the kernels need no weights of their own.

    Parameters
    ----------
    distances : (k, k) float64
        Geodesic distances over the square root of the surface's area.
    weights : (k,) float64
        Share of the area that each sample stands for; they sum to 1.

    Returns
    -------
    (160,) float64
        60 + 60 + 40 logarithms, falling within each kernel. Where there are fewer samples the rest stands at the
        floor, the logarithm of `tolerances.SPECTRUM_FLOOR`.
    """
    root = np.sqrt(weights)
    return np.concatenate([_logarithms(root[:, None] * f(distances) * root, kept) for f, kept in _KERNELS])


def _logarithms(matrix: Floats, kept: int) -> Floats:
    magnitudes = np.sort(np.abs(eigvalsh(matrix, overwrite_a=True, check_finite=False)))[::-1][:kept]
    padded = np.zeros(kept)
    padded[: len(magnitudes)] = magnitudes
    return np.log(np.maximum(padded, SPECTRUM_FLOOR))
