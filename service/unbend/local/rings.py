"""Rings between neighbouring circles, without what they repeat of each other."""

from __future__ import annotations

from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

R = TypeVar("R", np.float32, np.float64)

_CARRIED: Final = 0.6
"""Share of a ring's deviation that the next ring repeats."""

_PRECISION: Final = 27.0
"""One over the usual deviation that is left: 0.037 of the square of the radius.

Between poses of one shape, the deviations of neighbouring rings are those of a first-order autoregression, with nearly
the same constants at all radii (benchmarks/partial/pieces.py, measured on half of the classes of SHREC'11).
"""


def unrepeated(rings: NDArray[R]) -> NDArray[R]:
    """Return what each ring but the first does not repeat of the ring before it, in usual deviations, (c, r - 1).

    `rings` (c, r) has areas between neighbouring circles, over the square of the larger radius.
    """
    return np.asarray(_PRECISION * (rings[:, 1:] - _CARRIED * rings[:, :-1]), rings.dtype)
