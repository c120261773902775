"""The policy for properties of a mesh that can be treated in more than one way."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final, Literal, get_args

from unbend.errors import ParameterError, check_choice
from unbend.jsons import JsonObject

Components = Literal["largest", "bridge", "error"]

Seams = Literal["stitch", "keep"]

FEWEST_VERTICES: Final = 4
"""The vertices of a tetrahedron. No closed surface has fewer."""

MOST_ROUNDS: Final = 100
"""Largest number of rounds of smoothing. A round enlarges low frequencies by up to 0.09 %, 100 by less than 10 %."""


@dataclass(frozen=True, repr=False)
class MeshPolicy(JsonObject):
    """The policy for reading a mesh that is cut along seams, not connected, noisy, or too large.

    It is hashable, and a round trip through JSON does not change it.

    Parameters
    ----------
    components : {"largest", "bridge", "error"}, default "largest"
        Keep the component of largest area, connect the components by the shortest links between their vertices, or
        raise an error if there are several. Vertices of dropped components stay in the surface without faces, so that
        indices do not change.
    max_vertices : int, optional
        Simplify a mesh whose faces use more vertices. The surface then has new vertices, and its `vertex_map` maps
        the vertices of the mesh to the new ones.
    smooth : int, default 0
        Rounds of smoothing (Taubin 1995), 0 to 100, which remove noise and keep indices. Smoothing comes before links
        and simplification, so that noise does not affect either.
    seams : {"stitch", "keep"}, default "stitch"
        "stitch" joins boundary edges whose ends coincide, because files split vertices where normals or texture
        coordinates jump; `vertex_map` then maps all copies of a vertex to one vertex. "keep" leaves the surface cut.

    Raises
    ------
    ParameterError
        If a value is not one of those listed, `max_vertices` is below 4, or `smooth` is not 0 to 100.
    """

    display_name: ClassVar = "policy"

    components: Components = "largest"
    max_vertices: int | None = None
    smooth: int = 0
    seams: Seams = "stitch"

    def __post_init__(self) -> None:
        for name, allowed in (("components", Components), ("seams", Seams)):
            check_choice(name, getattr(self, name), get_args(allowed))
        if self.max_vertices is not None and not _is_whole(self.max_vertices, FEWEST_VERTICES):
            raise ParameterError(
                f"max_vertices must be a whole number from {FEWEST_VERTICES}, or None, not {self.max_vertices!r}"
            )
        if not _is_whole(self.smooth, 0, MOST_ROUNDS):
            raise ParameterError(f"smooth must be a whole number, 0 to {MOST_ROUNDS}, not {self.smooth!r}")


def _is_whole(value: object, lowest: int, highest: float = math.inf) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and lowest <= value <= highest


PolicyLike = MeshPolicy | Mapping[str, Any] | None
"""A policy, some of its fields, or None for the defaults."""
