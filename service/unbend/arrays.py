"""Array types, and read-only copies of arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Ints = NDArray[np.signedinteger[Any]]  # int32 where kernels take them; docstrings say which
Indices = NDArray[np.int64]
Codes = NDArray[np.int32]
Bools = NDArray[np.bool]


def positions_of(chosen: NDArray[np.signedinteger[Any]], count: int) -> Indices:
    """Return for each of `count` elements its position among the chosen ones, -1 for the others, (count,)."""
    positions = np.full(count, -1)
    positions[chosen] = np.arange(len(chosen))
    return positions


def frozen(array: Any, dtype: Any) -> NDArray[Any]:
    """Return `array` as a contiguous, read-only copy of `dtype`."""
    result = np.array(array, dtype=dtype, order="C")
    result.flags.writeable = False
    return result
