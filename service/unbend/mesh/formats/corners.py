"""Checks of the corners of faces in files: each must be the index of a vertex."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np

from unbend.arrays import Indices
from unbend.errors import MeshReadError

_MOST: Final = 2.0**53  # double precision represents all whole numbers up to here


def whole(numbers: Any, counts: Indices, where: Callable[[int], str]) -> Indices:
    """Return the corners (k,) of faces, which have `counts` (p,) corners each, as integers.

    Raises
    ------
    MeshReadError
        If a corner is not a whole number. `where` maps the index of a face to its place in the file.
    """
    if numbers.dtype.kind == "f":
        with np.errstate(invalid="ignore"):
            wrong = ~((np.floor(numbers) == numbers) & (np.abs(numbers) < _MOST))
        if wrong.any():
            at = int(np.flatnonzero(wrong)[0])
            raise MeshReadError(f"{where(_face(at, counts))}: {numbers[at]:.15g} is not the index of a vertex")
    integers: Indices = numbers.astype(np.int64)
    return integers


def check_corners(corners: Indices, counts: Indices, vertices: int, where: Callable[[int], str]) -> None:
    """Raise MeshReadError if a corner is not the index of a vertex, from 0 to `vertices` - 1."""
    if len(corners) and not 0 <= corners.min() <= corners.max() < vertices:
        at = int(np.flatnonzero((corners < 0) | (corners >= vertices))[0])
        raise MeshReadError(
            f"{where(_face(at, counts))}: a face uses vertex {corners[at]}, but the vertices are 0 to {vertices - 1}"
        )


def _face(corner: int, counts: Indices) -> int:
    return int(np.searchsorted(np.cumsum(counts), corner, side="right"))
