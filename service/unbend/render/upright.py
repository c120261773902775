"""The upright axis of a surface, which files do not tell."""

from __future__ import annotations

from typing import Literal

from unbend.mesh.surface import Surface


def upright_axis(surface: Surface) -> Literal["y", "z"]:
    """Return the axis that points upwards, y or z."""
    del surface
    return "z"
