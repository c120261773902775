"""Checks of the corners that files give their faces: each must be the index of a vertex."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np

from unbend.arrays import Indices
from unbend.errors import MeshReadError

_MOST: Final = 2.0**53  # double precision holds all whole numbers up to here


def whole(numbers: Any, counts: Indices, where: Callable[[int], str]) -> Indices:
    """Return the corners (k,) of faces with `counts` (p,) corners each as integers.

    Raises
    ------
    MeshReadError
        If a corner is not a whole number. `where` returns the place of a face in the file, given its index.
    """
    if numbers.dtype.kind == "f":
        with np.errstate(invalid="ignore"):
            wrong = ~((np.floor(numbers) == numbers) & (np.abs(numbers) < _MOST))
        if wrong.any():
            at = int(np.flatnonzero(wrong)[0])
            raise MeshReadError(f"{where(_face(at, counts))}: {numbers[at]:.15g} is not a vertex")
    integers: Indices = numbers.astype(np.int64)
    return integers


def check_corners(corners: Indices, counts: Indices, vertices: int, where: Callable[[int], str]) -> None:
    """Raise MeshReadError if a corner is not the index of a vertex, from 0 to `vertices` - 1."""
    if len(corners) and not 0 <= corners.min() <= corners.max() < vertices:
        at = int(np.flatnonzero((corners < 0) | (corners >= vertices))[0])
        raise MeshReadError(
            f"{where(_face(at, counts))}: a face with vertex {corners[at]}, outside the {vertices} there are"
        )


def _face(corner: int, counts: Indices) -> int:
    return int(np.searchsorted(np.cumsum(counts), corner, side="right"))
