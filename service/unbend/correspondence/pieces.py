"""Whether one surface is a piece of another."""

from __future__ import annotations

from typing import Final, Literal, get_args

import numpy as np

from unbend.errors import UnsuitedError, check_choice
from unbend.mesh.smooth import boundary_edges
from unbend.mesh.surface import Surface

Part = Literal["auto", "no", "a"]
"""Whether `a` is a piece of `b`: decided by boundary and area, never, or always."""

_OPEN: Final = 0.25
"""Length of a boundary over the square root of the area from which a surface counts as open."""

_SHARES: Final = (0.05, 0.95)
"""Area of a piece over that of its whole. Outside this range, the surfaces differ in scale or are alike."""


def is_part(a: Surface, b: Surface, part: Part) -> bool:
    """Return whether to match `a` as a piece of `b`.

    Raises
    ------
    ParameterError
        If `part` is not one of its values.
    UnsuitedError
        If `b` looks like a piece of `a`.
    """
    check_choice("part", part, get_args(Part))
    if part == "auto" and _looks_like_piece(b, a):
        raise UnsuitedError(
            "b is open, and smaller than a: if it is a piece of a, match it to a, the piece first; "
            "otherwise, take both as wholes, with part='no'"
        )
    return part == "a" or (part == "auto" and _looks_like_piece(a, b))


def _looks_like_piece(small: Surface, large: Surface) -> bool:
    if not (small.area > 0 and large.area > 0 and _SHARES[0] <= small.area / large.area < _SHARES[1]):
        return False
    return _is_open(small) and not _is_open(large)


def _is_open(surface: Surface) -> bool:
    ends = surface.vertices[boundary_edges(surface)]
    return float(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).sum()) > _OPEN * float(np.sqrt(surface.area))
