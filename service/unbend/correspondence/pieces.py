"""Whether one surface is a piece of another."""

from __future__ import annotations

from typing import Final, Literal, get_args

from unbend.errors import UnsuitedError, check_choice
from unbend.mesh.smooth import relative_boundary
from unbend.mesh.surface import Surface
from unbend.tolerances import PIECE_BOUNDARY

Part = Literal["auto", "no", "a"]
"""Whether `a` is a piece of `b`: decided by boundary and area, never, or always."""

_SHARES: Final = (0.05, 0.95)
"""Area of a piece over that of its whole. Outside this range, the surfaces differ in scale or are alike."""


def is_part(a: Surface, b: Surface, part: Part) -> bool:
    """Return whether to match `a` as a piece of `b`.

    Raises
    ------
    ParameterError
        If `part` is not one of its values.
    UnsuitedError
        If `part` is "auto" and `b` looks like a piece of `a`.
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
    return relative_boundary(small) > PIECE_BOUNDARY >= relative_boundary(large)
