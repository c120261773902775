"""Colours: themes, colour maps, and the conversion between sRGB and linear light."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np

from unbend.arrays import Floats
from unbend.errors import check_choice

Colour = tuple[float, float, float]
"""Red, green and blue in sRGB, 0 to 1."""

ThemeName = Literal["light", "dark", "transparent"]

ColourMap = Literal["viridis", "coolwarm"]

STEPS: Final = 256
"""Number of colours in the table of a colour map."""


def colour(code: str) -> Colour:
    """Return the colour of a code such as "#21918c"."""
    red, green, blue = (int(code[place : place + 2], 16) / 255 for place in (1, 3, 5))
    return red, green, blue


@dataclass(frozen=True)
class Theme:
    """The colours of a picture."""

    background: Colour | None
    """None for a transparent background."""
    surface: Colour
    """The colour of a surface without a field."""
    signature: Colour
    """The colour of a signature without a field."""
    unknown: Colour
    """The colour where a field is not finite."""
    contour: Colour
    path: Colour
    start: Colour
    """The colour of the marker at the first vertex."""
    end: Colour
    """The colour of the marker at the last vertex."""


_LIGHT: Final = Theme(
    background=colour("#ffffff"),
    surface=colour("#9fb6cf"),
    signature=colour("#e3b58a"),
    unknown=colour("#b9b9b9"),
    contour=colour("#14202c"),
    path=colour("#e0362c"),
    start=colour("#e0362c"),
    end=colour("#ffffff"),
)

THEMES: Final[dict[ThemeName, Theme]] = {
    "light": _LIGHT,
    "dark": Theme(
        background=colour("#14181d"),
        surface=colour("#a9bfd6"),
        signature=colour("#e6b98e"),
        unknown=colour("#7d8288"),
        contour=colour("#0c1116"),
        path=colour("#ff5a4d"),
        start=colour("#ff5a4d"),
        end=colour("#ffffff"),
    ),
    "transparent": replace(_LIGHT, background=None),
}

_POINTS: Final[dict[ColourMap, tuple[str, ...]]] = {
    "viridis": (
        "#440154", "#482475", "#414487", "#355f8d", "#2a788e", "#21918c", "#22a884", "#44bf70", "#7ad151", "#bddf26",
        "#fde725",
    ),  # van der Walt & Smith 2015, every tenth colour; perceptually uniform
    "coolwarm": ("#3b4cc0", "#6788ee", "#9abbff", "#c9d7f0", "#dddddd", "#edd1c2", "#f7a889", "#e26952", "#b40426"),
}  # fmt: skip


def colour_table(name: ColourMap) -> Floats:
    """Return the colours of a colour map from its lowest value to its highest, (256, 3) in sRGB.

    "viridis" is perceptually uniform, for values that grow; "coolwarm" (Moreland 2009) diverges from grey, for values
    on both sides of 0. ParameterError if the name is neither.
    """
    check_choice("colour_map", name, tuple(_POINTS))
    points = np.array([colour(code) for code in _POINTS[name]])
    places = np.linspace(0, len(points) - 1, STEPS)
    return np.stack([np.interp(places, np.arange(len(points)), part) for part in points.T], axis=1)


def to_linear(srgb: Floats) -> Floats:
    """Return sRGB values, 0 to 1, as linear light."""
    return np.asarray(np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4))


def to_srgb(linear: Floats) -> Floats:
    """Return linear light, 0 to 1, as sRGB values."""
    return np.asarray(np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055))
