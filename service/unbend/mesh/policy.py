"""What to do about defects that have more than one reasonable answer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from unbend.errors import ParameterError

Components = Literal["largest", "error"]


@dataclass(frozen=True)
class MeshPolicy:
    """How reading treats a mesh that is not one connected surface.

    Parameters
    ----------
    components : {"largest", "error"}, default "largest"
        Keep the component with the largest area, or refuse a mesh of several. Vertices of dropped components
        stay in the surface, so that indices do not shift; no face uses them.

    Raises
    ------
    ParameterError
        If a value is not one of those listed.
    """

    components: Components = "largest"

    def __post_init__(self) -> None:
        if self.components not in get_args(Components):
            raise ParameterError(f"components must be one of {get_args(Components)}, not {self.components!r}")
