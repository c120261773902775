"""Largest eigenvalues of a symmetric matrix that is only multiplied by: block Lanczos (Golub & Van Loan, ch. 10)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from unbend.arrays import Floats
from unbend.tolerances import EIGENPAIR_RESIDUAL

_SPARE: Final = 3  # columns beyond those wanted: they keep close and repeated eigenvalues apart
_STEPS: Final = 30
_SMALL: Final = 400  # a dense solver is as quick

Multiply = Callable[[Floats], Floats]


def is_worthwhile(size: int, wanted: int) -> bool:
    """Whether a matrix is so large that a dense solver is not as quick."""
    return size >= max(_SMALL, (wanted + _SPARE) * _STEPS)


def leading_eigenpairs(multiply: Multiply, start: Floats) -> tuple[Floats, Floats] | None:
    """Return the largest eigenvalues, falling, and their vectors, as many as `start` has columns.

    None where they did not converge. For matrices that `is_worthwhile` is true of.

    Parameters
    ----------
    multiply : callable
        Multiplies columns, (size, b), by the matrix.
    start : (size, wanted) float64
        Near the vectors, if possible.
    """
    size, wanted = start.shape
    width = wanted + _SPARE
    basis, images = np.empty((2, _STEPS * width, size))  # columns as rows, so that a step fills what lies together
    spare = np.random.default_rng(0).standard_normal((size, _SPARE)) * np.abs(start).max()
    block = np.linalg.qr(np.hstack([start, spare]))[0]
    for step in range(_STEPS):
        start, stop = step * width, (step + 1) * width
        basis[start:stop], images[start:stop] = block.T, multiply(block).T
        values, vectors, residual = _ritz_pairs(basis[:stop].T, images[:stop].T, wanted)
        if residual <= EIGENPAIR_RESIDUAL * np.abs(values).max():
            return values, vectors
        block = _orthogonalised(images[start:stop].T, basis[:stop].T)
    return None


def _orthogonalised(block: Floats, basis: Floats) -> Floats:
    """Return an orthonormal basis of what `block` adds to `basis`; twice is enough (Kahan)."""
    for _ in range(2):
        block = np.linalg.qr(block - basis @ (basis.T @ block))[0]
    return block


def _ritz_pairs(basis: Floats, images: Floats, wanted: int) -> tuple[Floats, Floats, float]:
    """Return the best eigenpairs within `basis`, and the largest norm of what they miss."""
    projected = basis.T @ images
    values, small = np.linalg.eigh((projected + projected.T) / 2)
    values, small = values[: -wanted - 1 : -1], small[:, : -wanted - 1 : -1]
    vectors = basis @ small
    residuals = images @ small - vectors * values
    return values, vectors, float(np.linalg.norm(residuals, axis=0).max())
