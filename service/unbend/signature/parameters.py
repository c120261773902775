"""The choices that a signature depends on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Final, Literal, get_args

from unbend.embedding.dimension import MAX_DIMENSIONS
from unbend.embedding.embed import AUTO, Method
from unbend.errors import ParameterError
from unbend.geodesics.distances import Update
from unbend.jsons import JsonObject

Scaling = Literal["area", "box"]

Dimensions = int | Literal["auto"]

MAX_SAMPLES: Final = 5000


@dataclass(frozen=True)
class Parameters(JsonObject):
    """What a signature is computed with; hashable, and the same after a round trip through JSON.

    Parameters
    ----------
    samples : int, default 300
        Farthest point samples, 4 to 5000; all vertices where the surface has fewer.
    dimensions : int or "auto", default 3
        Of the space the signature lives in, 1 to 12; "auto" is the surface's effective dimension
        (`effective_dimension`).
    method : {"least_squares", "classical", "fast"}
        How samples are embedded.
    update : {"spherical", "planar"}
        How fast marching crosses a triangle.
    scaling : {"area", "box"}
        What is made 1: the area of the surface, or the longest side of the signature's bounding box (the
        paper's). Area is the default, for a box hangs on the few points that touch it. Descriptors are always
        those for area 1.

    Raises
    ------
    ParameterError
        If a value is out of its range or of the wrong type.
    """

    called: ClassVar = "parameters"

    samples: int = 300
    dimensions: Dimensions = 3
    method: Method = "least_squares"
    update: Update = "spherical"
    scaling: Scaling = "area"

    def __post_init__(self) -> None:
        _check_int("samples", self.samples, 4, MAX_SAMPLES)
        if self.dimensions != AUTO:
            _check_int("dimensions", self.dimensions, 1, MAX_DIMENSIONS, f'or "{AUTO}", ')
        _check_choice("method", self.method, get_args(Method))
        _check_choice("update", self.update, get_args(Update))
        _check_choice("scaling", self.scaling, get_args(Scaling))


def _check_int(name: str, value: object, least: int, most: int, other: str = "") -> None:
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
        raise ParameterError(f"{name} must be a whole number from {least} to {most}, {other}not {value!r}")


def _check_choice(name: str, value: object, choices: tuple[str, ...]) -> None:
    if value not in choices:
        raise ParameterError(f"{name} must be one of {', '.join(choices)}, not {value!r}")
