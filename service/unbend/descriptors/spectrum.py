"""The geodesic spectrum, after Smeets et al., "Isometric deformation invariant 3D shape recognition" (2012: SD-GDM)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from scipy.linalg import eigvalsh

from unbend.arrays import Floats
from unbend.tolerances import DENSITY_FLOOR, SPECTRUM_FLOOR

Kernel = Callable[[Floats, Floats], Floats]
"""A function of distances (k, k) on a surface of area 1 and of the samples' shares of the area (k,).

It returns a matrix (k, k).
"""


def three_quarters(distances: Floats, _shares: Floats) -> Floats:
    """Return d^0.75, a kernel of global scale."""
    # Two square roots are faster than a power.
    return np.asarray(np.sqrt(distances * np.sqrt(distances)))


def gaussian(width: float) -> Kernel:
    """Return exp(-(d / s)^2), a kernel of scale s."""
    return lambda distances, _shares: np.asarray(np.exp(-((distances / width) ** 2)))


def diffusion(width: float) -> Kernel:
    """Return the symmetric form of a random walk with Gaussian steps, corrected for the density of the samples.

    Coifman & Lafon, "Diffusion maps" (2006), section 3.4, with alpha = 1. As samples become denser and s smaller, the
    logarithms of the eigenvalues tend to the eigenvalues of the Laplace-Beltrami operator times -s^2 / 4.
    """
    affinity = gaussian(width)

    def walk(distances: Floats, shares: Floats) -> Floats:
        near = affinity(distances, shares)
        density = np.maximum(near @ shares, DENSITY_FLOOR)
        near /= np.outer(density, density)
        degree = np.sqrt(np.maximum(near @ shares, DENSITY_FLOOR))
        return np.asarray(near / np.outer(degree, degree))

    return walk


KERNELS: Final[tuple[tuple[Kernel, int], ...]] = ((three_quarters, 60), (diffusion(0.14), 20), (gaussian(0.3), 40))
"""Kernels from global to local scale, each with the number of eigenvalues that are kept.

`benchmarks/retrieval/choice.py` chose kernels, widths and counts on half of the classes.
"""


def geodesic_spectrum(distances: Floats, weights: Floats, kernels: Sequence[tuple[Kernel, int]] = KERNELS) -> Floats:
    """Return the logarithms of the largest eigenvalues of the area-weighted distance matrix, under several kernels.

    For a kernel f these are the eigenvalues of largest magnitude of diag(sqrt w) f(D) diag(sqrt w). They approximate
    the eigenvalues of the operator that averages f(d(x, .)) over the surface. So they do not depend on the order of the
    samples, and, as the samples become denser, they do not depend on the choice of samples. On real shapes, differences
    of logarithms have similar sizes under all kernels, so the kernels need no weights.

    Parameters
    ----------
    distances : (k, k) float64
        Geodesic distances over the square root of the surface's area.
    weights : (k,) float64
        Share of the area that each sample represents; they sum to 1.
    kernels : sequence of (Kernel, int), default KERNELS
        Each kernel with the number of its eigenvalues that are kept.

    Returns
    -------
    (120,) float64
        60 + 20 + 40 logarithms for the default kernels, falling within each kernel. With fewer samples, missing values
        are the logarithm of `tolerances.SPECTRUM_FLOOR`.
    """
    root = np.sqrt(weights)
    return np.concatenate(
        [_logarithms(root[:, None] * kernel(distances, weights) * root, kept) for kernel, kept in kernels]
    )


def _logarithms(matrix: Floats, kept: int) -> Floats:
    magnitudes = np.sort(np.abs(eigvalsh(matrix, overwrite_a=True, check_finite=False)))[::-1][:kept]
    padded = np.zeros(kept)
    padded[: len(magnitudes)] = magnitudes
    return np.log(np.maximum(padded, SPECTRUM_FLOOR))
