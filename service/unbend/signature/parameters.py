"""Parameters of a signature."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar, Final, Literal, get_args

from unbend.embedding.dimension import MAX_DIMENSIONS
from unbend.embedding.embed import AUTO, MAX_STARTS, Criterion, Method
from unbend.embedding.weighting import Weighting
from unbend.errors import ParameterError, check_choice
from unbend.geodesics.distances import Update
from unbend.jsons import JsonObject

Scaling = Literal["area", "box"]

FirstSample = Literal["end", "random"]

Samples = int | Literal["auto"]

Dimensions = int | Literal["auto"]

MAX_SAMPLES: Final = 5000

MAX_SEED: Final = 2**32 - 1


@dataclass(frozen=True, repr=False)
class Parameters(JsonObject):
    """Parameters of a signature. They are hashable, and equal after a round trip through JSON.

    Parameters
    ----------
    samples : int or "auto", default 300
        Number of farthest point samples, 4 to 5000. If the surface has fewer vertices, all are samples. "auto" starts
        with 64 and doubles the number until the spectrum changes by at most `tolerance`.
    dimensions : int or "auto", default 3
        Dimensions of the signature, 1 to 12. "auto" takes the least number for which `criterion` is at most
        `threshold`.
    method : {"least_squares", "classical", "fast"}
        Method of multidimensional scaling.
    update : {"spherical", "planar"}
        Update equation of fast marching in a triangle.
    scaling : {"area", "box"}
        Quantity that is scaled to 1: the area of the surface, or the longest side of the signature's bounding box
        (the paper's choice). Area is the default because a bounding box depends on a few extreme points. Descriptors
        always refer to area 1.
    first_sample : {"end", "random"}
        First sample: an end of the surface, or a random vertex that depends on `seed`.
    starts : int, default 0
        Additional starts of least squares at random points, up to 20. The result of lowest stress is kept.
    seed : int, default 0
        Seed of all random choices, 0 to 2^32 - 1.
    weights : {"equal", "inverse", "inverse_squared", "area"}
        Weights of pairs in eq. 2: 1, 1 / d, 1 / d^2, or the product of the areas that both samples represent. "inverse"
        and "inverse_squared" require the method "least_squares". The method "fast" does not support "area".
    criterion : {"error", "stress"}
        Quantity that `threshold` bounds if `dimensions` is "auto": the representation error of eq. 6, or the stress of
        eq. 2.
    threshold : float, default 0.05
        Upper bound of the criterion, above 0 and below 1.
    tolerance : float, default 0.02
        Largest change of the spectrum, as a share of its L1 norm, if `samples` is "auto". Above 0 and below 1.

    Raises
    ------
    ParameterError
        If a value is out of its range or of the wrong type.
    """

    display_name: ClassVar = "parameters"

    samples: Samples = 300
    dimensions: Dimensions = 3
    method: Method = "least_squares"
    update: Update = "spherical"
    scaling: Scaling = "area"
    first_sample: FirstSample = "end"
    starts: int = 0
    seed: int = 0
    weights: Weighting = "equal"
    criterion: Criterion = "error"
    threshold: float = 0.05
    tolerance: float = 0.02

    def __post_init__(self) -> None:
        if self.samples != AUTO:
            _check_int("samples", self.samples, 4, MAX_SAMPLES, f'or "{AUTO}", ')
        if self.dimensions != AUTO:
            _check_int("dimensions", self.dimensions, 1, MAX_DIMENSIONS, f'or "{AUTO}", ')
        _check_int("starts", self.starts, 0, MAX_STARTS)
        _check_int("seed", self.seed, 0, MAX_SEED)
        for name, choices in _CHOICES.items():
            check_choice(name, getattr(self, name), get_args(choices))
        _check_share("threshold", self.threshold)
        _check_share("tolerance", self.tolerance)
        _check_method(self.method, self.weights, self.starts)

    def as_dict(self) -> dict[str, Any]:
        """Return the fields as plain JSON values, without fields of later versions that have their default value.

        So the JSON of older parameters never changes, and stored signatures can still be found by it.
        """
        defaults = {field.name: field.default for field in fields(self)}
        return {
            name: value
            for name, value in super().as_dict().items()
            if name in _ORIGINAL_FIELDS or value != defaults[name]
        }


_ORIGINAL_FIELDS: Final = ("samples", "dimensions", "method", "update", "scaling")

_CHOICES: Final = {
    "method": Method,
    "update": Update,
    "scaling": Scaling,
    "first_sample": FirstSample,
    "weights": Weighting,
    "criterion": Criterion,
}


def _check_method(method: Method, weights: Weighting, starts: int) -> None:
    """Raise ParameterError if the method does not support the starts or weights."""
    if starts and method != "least_squares":
        raise ParameterError(f"starts go with the method least_squares only, not with {method}")
    if weights.startswith("inverse") and method != "least_squares":
        raise ParameterError(f"weights {weights} go with the method least_squares only, not with {method}")
    if weights == "area" and method == "fast":
        raise ParameterError("weights area go with the methods least_squares and classical only, not with fast")


def _check_int(name: str, value: object, least: int, most: int, other: str = "") -> None:
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
        raise ParameterError(f"{name} must be a whole number from {least} to {most}, {other}not {value!r}")


def _check_share(name: str, value: object) -> None:
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < 1:
        raise ParameterError(f"{name} must be a number above 0 and below 1, not {value!r}")


ParametersLike = Parameters | Mapping[str, Any] | None
"""Parameters, some of their fields, or None for the defaults."""
