"""Nearest rows of matrices, by matrix products, which use the processor better than search trees in many dimensions."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from unbend.arrays import Indices


def nearest_rows(queries: NDArray[Any], rows: NDArray[Any]) -> Indices:
    """Return the index of the nearest of `rows` (n, d) for each of `queries` (m, d), in single precision, (m,)."""
    single = rows.astype(np.float32, copy=False)
    scores = queries.astype(np.float32, copy=False) @ single.T
    scores *= -2
    scores += np.einsum("nd,nd->n", single, single)
    return np.asarray(scores.argmin(axis=1))
