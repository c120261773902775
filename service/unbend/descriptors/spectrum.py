"""Geodesic spectrum, after Smeets et al., "Isometric deformation invariant 3D shape recognition" (2012: SD-GDM)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.linalg import eigvalsh

from unbend.arrays import Floats
from unbend.descriptors.kernels import Kernel, diffusion, gaussian, three_quarters
from unbend.tolerances import SPECTRUM_FLOOR

KERNELS: Final[tuple[tuple[Kernel, int], ...]] = ((three_quarters, 60), (diffusion(0.14), 20), (gaussian(0.3), 40))
"""From the whole to the near, and how many eigenvalues of each are kept.

`benchmarks/retrieval_choice.py` chose them among combinations of kernels, widths and counts, on half of the classes.
"""


def geodesic_spectrum(distances: Floats, weights: Floats, kernels: Sequence[tuple[Kernel, int]] = KERNELS) -> Floats:
    """Return the logarithms of the largest eigenvalues of the area-weighted distance matrix, under several kernels.

    For a kernel f these are the eigenvalues of diag(sqrt w) f(D) diag(sqrt w), by magnitude, which approximate
    those of the operator that averages f(d(x, .)) over the surface: they depend on no order of the samples and,
    as the samples grow denser, on no particular samples. Differences of logarithms are of one size under all
    kernels, on real shapes, so that the kernels need no weights of their own.

    Parameters
    ----------
    distances : (k, k) float64
        Geodesic distances over the square root of the surface's area.
    weights : (k,) float64
        Share of the area that each sample stands for; they sum to 1.
    kernels : sequence of (Kernel, int), default KERNELS
        And how many eigenvalues of each are kept.

    Returns
    -------
    (120,) float64
        60 + 20 + 40 logarithms, falling within each kernel. Where there are fewer samples the rest stands at the
        floor, the logarithm of `tolerances.SPECTRUM_FLOOR`.
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
