"""The choices that a signature depends on."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, Final, Literal, Self, get_args

from unbend.embedding.embed import Method
from unbend.errors import ParameterError
from unbend.geodesics.distances import Update

Scaling = Literal["area", "box"]

MAX_SAMPLES: Final = 5000
MAX_DIMENSIONS: Final = 12


@dataclass(frozen=True)
class Parameters:
    """What a signature is computed with; hashable, and the same after a round trip through JSON.

    Parameters
    ----------
    samples : int, default 300
        Farthest point samples, 4 to 5000; all vertices where the surface has fewer.
    dimensions : int, default 3
        Of the space the signature lives in, 1 to 12.
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

    samples: int = 300
    dimensions: int = 3
    method: Method = "least_squares"
    update: Update = "spherical"
    scaling: Scaling = "area"

    def __post_init__(self) -> None:
        _check_int("samples", self.samples, 4, MAX_SAMPLES)
        _check_int("dimensions", self.dimensions, 1, MAX_DIMENSIONS)
        _check_choice("method", self.method, get_args(Method))
        _check_choice("update", self.update, get_args(Update))
        _check_choice("scaling", self.scaling, get_args(Scaling))

    def as_dict(self) -> dict[str, Any]:
        """Return the parameters as plain JSON values."""
        return asdict(self)

    def to_json(self) -> str:
        """Return canonical JSON: equal parameters give equal text."""
        return json.dumps(self.as_dict(), sort_keys=True, separators=(",", ":"))

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """Make parameters from some of their fields; ParameterError names an unknown one."""
        known = {field.name for field in fields(cls)}
        unknown = sorted(set(values) - known)
        if unknown:
            raise ParameterError(f"unknown parameter {unknown[0]!r}; known are {', '.join(sorted(known))}")
        return cls(**values)

    @classmethod
    def from_json(cls, text: str) -> Self:
        """Make parameters from JSON text; ParameterError if it is not an object of known fields."""
        values = parse_json(text, "parameters")
        if not isinstance(values, dict):
            raise ParameterError("parameters must be a JSON object")
        return cls.from_dict(values)


def parse_json(text: str, what: str) -> Any:
    """Return the value of JSON text; ParameterError where it is none, or nested too deeply."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        reason = "nested too deeply" if isinstance(error, RecursionError) else f"not JSON: {error}"
        raise ParameterError(f"{what}: {reason}") from None


def _check_int(name: str, value: object, least: int, most: int) -> None:
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
        raise ParameterError(f"{name} must be a whole number from {least} to {most}, not {value!r}")


def _check_choice(name: str, value: object, choices: tuple[str, ...]) -> None:
    if value not in choices:
        raise ParameterError(f"{name} must be one of {', '.join(choices)}, not {value!r}")
