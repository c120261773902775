"""What to do about defects that have more than one reasonable answer."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Final, Literal, get_args

from unbend.errors import ParameterError
from unbend.jsons import JsonObject

Components = Literal["largest", "bridge", "error"]

Seams = Literal["stitch", "keep"]

FEWEST_VERTICES: Final = 4
"""A tetrahedron's: no closed surface has fewer."""

MOST_ROUNDS: Final = 100
"""Of smoothing: each enlarges the slowest waves by up to 0.09 %, so all of them by less than a tenth."""


@dataclass(frozen=True)
class MeshPolicy(JsonObject):
    """How reading treats a mesh that is cut along seams, is not connected, is noisy, or has more vertices than wanted.

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
    smooth : int, default 0
        Rounds of smoothing (Taubin 1995), 0 to 100, that take noise off; indices stay. It comes before links and
        simplification, so that these see the shape and not the noise.
    seams : {"stitch", "keep"}, default "stitch"
        Join boundary edges whose ends coincide: files split vertices where normals or texture coordinates jump. The
        copies of a vertex become one, and `vertex_map` says which. Or leave the surface cut there.

    Raises
    ------
    ParameterError
        If a value is not one of those listed, `max_vertices` is below 4, or `smooth` is not 0 to 100.
    """

    called: ClassVar = "policy"

    components: Components = "largest"
    max_vertices: int | None = None
    smooth: int = 0
    seams: Seams = "stitch"

    def __post_init__(self) -> None:
        for name, allowed in (("components", Components), ("seams", Seams)):
            if (value := getattr(self, name)) not in get_args(allowed):
                raise ParameterError(f"{name} must be one of {', '.join(get_args(allowed))}, not {value!r}")
        if self.max_vertices is not None and not _is_whole(self.max_vertices, FEWEST_VERTICES):
            raise ParameterError(
                f"max_vertices must be a whole number from {FEWEST_VERTICES}, or None, not {self.max_vertices!r}"
            )
        if not _is_whole(self.smooth, 0, MOST_ROUNDS):
            raise ParameterError(f"smooth must be a whole number, 0 to {MOST_ROUNDS}, not {self.smooth!r}")


def _is_whole(value: object, lowest: int, highest: float = math.inf) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and lowest <= value <= highest
