"""What to do about defects that have more than one reasonable answer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Final, Literal, get_args

from unbend.errors import ParameterError
from unbend.jsons import JsonObject

Components = Literal["largest", "bridge", "error"]

FEWEST_VERTICES: Final = 4
"""A tetrahedron's: no closed surface has fewer."""


@dataclass(frozen=True)
class MeshPolicy(JsonObject):
    """How reading treats a mesh that is not one connected surface, or has more vertices than wanted.

    Hashable, and the same after a round trip through JSON.

    Parameters
    ----------
    components : {"largest", "bridge", "error"}, default "largest"
        Keep the component with the largest area; or link the components to one, by the shortest possible links
        between their vertices; or refuse a mesh of several. Vertices of dropped components stay in the surface,
        so that indices do not shift; no face uses them.
    max_vertices : int, optional
        Simplify a mesh whose faces use more vertices. The surface then has vertices of its own, and its
        `vertex_map` says where those of the mesh went.

    Raises
    ------
    ParameterError
        If a value is not one of those listed, or `max_vertices` is below 4.
    """

    called: ClassVar = "policy"

    components: Components = "largest"
    max_vertices: int | None = None

    def __post_init__(self) -> None:
        if self.components not in get_args(Components):
            choices = ", ".join(get_args(Components))
            raise ParameterError(f"components must be one of {choices}, not {self.components!r}")
        if self.max_vertices is not None and not _is_count(self.max_vertices):
            raise ParameterError(
                f"max_vertices must be a whole number from {FEWEST_VERTICES}, or None, not {self.max_vertices!r}"
            )


def _is_count(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= FEWEST_VERTICES
