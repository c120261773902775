"""The largest eigenvalues of a symmetric linear operator, by block Lanczos (Golub & Van Loan, ch. 10)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from unbend.arrays import Floats
from unbend.tolerances import EIGENPAIR_RESIDUAL

_SPARE: Final = 3  # additional columns, which separate close and repeated eigenvalues
_STEPS: Final = 30
_SMALL: Final = 400  # below this size a dense solver is as fast

Multiply = Callable[[Floats], Floats]


def is_worthwhile(size: int, wanted: int) -> bool:
    """Return whether `leading_eigenpairs` is faster than a dense solver for a matrix of this size."""
    return size >= max(_SMALL, (wanted + _SPARE) * _STEPS)


def leading_eigenpairs(multiply: Multiply, start: Floats) -> tuple[Floats, Floats] | None:
    """Return the largest eigenvalues, falling, and their vectors, as many as `start` has columns.

    Return None if they did not converge. The size must satisfy `is_worthwhile`.

    Parameters
    ----------
    multiply : callable
        Multiplies columns, (size, b), by the matrix.
    start : (size, wanted) float64
        Starting vectors, if possible an approximation of the result.
    """
    size, wanted = start.shape
    width = wanted + _SPARE
    basis, images = np.empty((2, _STEPS * width, size))  # columns as rows, so that a step fills contiguous memory
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
    """Return an orthonormal basis of the part of `block` that is orthogonal to `basis`. Two passes suffice (Kahan)."""
    for _ in range(2):
        block = np.linalg.qr(block - basis @ (basis.T @ block))[0]
    return block


def _ritz_pairs(basis: Floats, images: Floats, wanted: int) -> tuple[Floats, Floats, float]:
    """Return the best eigenpairs within `basis`, and the largest norm of their residuals."""
    projected = basis.T @ images
    values, small = np.linalg.eigh((projected + projected.T) / 2)
    values, small = values[: -wanted - 1 : -1], small[:, : -wanted - 1 : -1]
    vectors = basis @ small
    residuals = images @ small - vectors * values
    return values, vectors, float(np.linalg.norm(residuals, axis=0).max())
