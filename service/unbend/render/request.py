"""The request for a picture, as a value."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Final, Literal, get_args

from unbend.errors import ParameterError, check_choice
from unbend.jsons import JsonObject
from unbend.render.colours import ThemeName
from unbend.render.draw import check_size
from unbend.render.view import ELEVATION

Format = Literal["png", "webp"]

Subject = Literal["surface", "signature", "both"]

Up = Literal["auto", "x", "y", "z"]

FIRST_FURTHER: Final = 4
"""First dimension of a form that colours can show; the first three are its place in space."""

LAST_FURTHER: Final = 6
"""Last dimension of a form that colours can show."""


@dataclass(frozen=True, repr=False)
class PictureRequest(JsonObject):
    """A picture to draw: hashable, and equal after a round trip through JSON.

    Parameters
    ----------
    width, height : int, default 512
        Pixels, 16 to 2048.
    format : {"png", "webp"}, default "png"
    subject : {"surface", "signature", "both"}, default "surface"
        The surface, its signature (the canonical form of every vertex, turned as the surface stands), or both side
        by side at the same scale.
    theme : {"light", "dark", "transparent"}, default "light"
    azimuth : float, optional
        Degrees by which the eye is turned around the upright axis from the front of the surface to its right, -360 to
        360. By default 35 or 55: a three-quarter view of the broader side.
    elevation : float, default 14
        Degrees of the eye above the horizon, -90 to 90.
    up : {"auto", "x", "y", "z"}, default "auto"
        Upright axis of the surface; "auto" chooses y or z (`unbend.render.upright.upright_axis`).
    distances_from : int, optional
        Vertex; colours then show the geodesic distance from it.
    dimension : int, optional
        4 to 6; colours then show this coordinate of the form. Not together with `distances_from`.
    contours : bool, default False
        Contours of the distances, or of the dimension.
    path : (int, int), optional
        Two vertices; the shortest path between them is drawn, and both are marked.

    Raises
    ------
    ParameterError
        If a value is out of its range, of the wrong type, or does not go with another.
    """

    display_name: ClassVar = "picture"

    width: int = 512
    height: int = 512
    format: Format = "png"
    subject: Subject = "surface"
    theme: ThemeName = "light"
    azimuth: float | None = None
    elevation: float = ELEVATION
    up: Up = "auto"
    distances_from: int | None = None
    dimension: int | None = None
    contours: bool = False
    path: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        check_size((self.width, self.height))
        for name, choices in _CHOICES.items():
            check_choice(name, getattr(self, name), get_args(choices))
        if self.azimuth is not None:
            _check_angle("azimuth", self.azimuth, 360)
        _check_angle("elevation", self.elevation, 90)
        contours: object = self.contours
        if not isinstance(contours, bool):
            raise ParameterError(f"contours must be true or false, not {self.contours!r}")
        self._check_field()
        self._check_path()

    @property
    def needs_form(self) -> bool:
        """Whether the picture shows anything of the canonical form."""
        return self.subject != "surface" or self.dimension is not None

    def _check_field(self) -> None:
        if self.distances_from is not None and not _is_vertex(self.distances_from):
            raise ParameterError(f"distances_from must be the number of a vertex, not {self.distances_from!r}")
        if self.dimension is not None and self.dimension not in range(FIRST_FURTHER, LAST_FURTHER + 1):
            raise ParameterError(
                f"dimension must be a whole number from {FIRST_FURTHER} to {LAST_FURTHER}, not {self.dimension!r}"
            )
        if self.distances_from is not None and self.dimension is not None:
            raise ParameterError("dimension: give distances_from or dimension, not both: colours show one of them")
        if self.contours and self.distances_from is None and self.dimension is None:
            raise ParameterError("contours go with distances_from or dimension only: there is nothing else to contour")

    def _check_path(self) -> None:
        if self.path is None:
            return
        given: object = self.path
        ends = tuple(given) if isinstance(given, list | tuple) else ()
        if len(ends) != 2 or not all(_is_vertex(end) for end in ends):
            raise ParameterError(f"path must be the numbers of two vertices, not {self.path!r}")
        object.__setattr__(self, "path", ends)  # JSON has lists only


_CHOICES: Final = {"format": Format, "subject": Subject, "theme": ThemeName, "up": Up}


def _is_vertex(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


def _check_angle(name: str, value: object, most: float) -> None:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= most:  # refuses NaN
        raise ParameterError(f"{name} must be a number of degrees from -{most} to {most}, not {value!r}")
