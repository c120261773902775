"""Cameras: a direction of view, fitted to what it shows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from unbend.arrays import Floats, frozen
from unbend.errors import ParameterError, check_choice

Axis = Literal["x", "y", "z"]

Size = tuple[int, int]
"""Width and height of a picture in pixels."""

THREE_QUARTER: Final = 35.0
"""Degrees between the view and the broad side, by default: a three-quarter view."""

ELEVATION: Final = 14.0
"""Degrees above the horizon, by default."""

MARGIN: Final = 0.06
"""Share of the picture's shorter side that stays free on each side."""

_EYE: Final = 4.5  # distance of the eye, in radii of what it shows: a long lens, which distorts little
_ROUNDS: Final = 4  # of centring in perspective; the error falls by a factor of five or more in each


@dataclass(frozen=True, eq=False)
class Camera:
    """An eye, and the part of space that it sees.

    Parameters
    ----------
    axes : (3, 3) float64
        Orthonormal rows: to the right, upwards, and towards the eye.
    centre : (3,) float64
        Point in the middle of the picture.
    span : float
        Length, at the centre, that the shorter side of the picture spans.
    distance : float, default inf
        Distance of the eye from the centre; infinite for an orthographic view.

    Raises
    ------
    ParameterError
        If `axes` are not orthonormal, `centre` is not finite, or a length is not above 0.
    """

    axes: Floats
    centre: Floats
    span: float
    distance: float = np.inf

    def __post_init__(self) -> None:
        object.__setattr__(self, "axes", frozen(self.axes, np.float64))
        object.__setattr__(self, "centre", frozen(self.centre, np.float64))
        if self.axes.shape != (3, 3) or not np.allclose(self.axes @ self.axes.T, np.eye(3), atol=1e-6):
            raise ParameterError("axes must be three orthonormal rows")
        if self.centre.shape != (3,) or not np.isfinite(self.centre).all():
            raise ParameterError("centre must be three finite numbers")
        if not (np.isfinite(self.span) and self.span > 0 and self.distance > 0):
            raise ParameterError("span and distance must be above 0, and span finite")

    def pixels(self, points: Floats, size: Size) -> Floats:
        """Return where `points` (n, 3) are in a picture, (n, 2): pixels from its left and its upper edge."""
        width, height = size
        seen = (points - self.centre) @ self.axes.T
        factor = min(width, height) / self.span / (1 - seen[:, 2] / self.distance)
        return np.stack([width / 2 + seen[:, 0] * factor, height / 2 - seen[:, 1] * factor], axis=1)


def view_axes(azimuth: float, elevation: float, up: Axis) -> Floats:
    """Return the axes of a camera, (3, 3).

    At azimuth 0 and elevation 0 the eye looks at the front: along +y where z is up, along -z where y is up, along +z
    where x is up. The azimuth turns it around the upright axis, to the right; the elevation raises it. Both in degrees.
    """
    check_choice("up", up, ("x", "y", "z"))
    x, y, z = np.eye(3)
    right, top = {"z": (x, z), "y": (x, y), "x": (y, x)}[up]
    front = np.cross(right, top)
    turn, rise = np.radians(azimuth), np.radians(elevation)
    level = np.cos(turn) * front + np.sin(turn) * right
    near = np.cos(rise) * level + np.sin(rise) * top
    across = np.cos(turn) * right - np.sin(turn) * front
    return np.stack([across, np.cross(near, across), near])


def fit_camera(points: Floats, axes: Floats, size: Size, *, perspective: bool = True) -> Camera:
    """Return the camera with given axes that shows all `points` as large as the picture allows.

    Parameters
    ----------
    points : (n, 3) float64
        At least one, all finite.
    axes : (3, 3) float64
        As `view_axes` returns them.
    size : (int, int)
        Width and height of the picture in pixels.
    perspective : bool, default True
        False for an orthographic view.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    centre = (low + high) / 2
    radius = float(np.sqrt(((points - centre) ** 2).sum(axis=1).max())) or 1.0
    distance = _EYE * radius if perspective else np.inf
    share = np.array(size) / min(size) - 2 * MARGIN  # of the shorter side, which is 1
    for _ in range(_ROUNDS):
        seen = (points - centre) @ axes.T
        flat = seen[:, :2] / (1 - seen[:, 2:] / distance)
        middle = (flat.min(axis=0) + flat.max(axis=0)) / 2
        centre = centre + middle @ axes[:2]
    seen = (points - centre) @ axes.T
    flat = seen[:, :2] / (1 - seen[:, 2:] / distance)
    span = float((np.abs(flat).max(axis=0) * 2 / share).max()) or 2 * radius
    return Camera(axes, centre, span, distance)


def default_azimuth(points: Floats, up: Axis) -> float:
    """Return the azimuth of the three-quarter view of the broader side: 35 degrees off it, from the front or a side."""
    across, _, near = view_axes(0.0, 0.0, up)
    wide = float(np.ptp(points @ across)) >= float(np.ptp(points @ near))
    return THREE_QUARTER if wide else 90.0 - THREE_QUARTER
