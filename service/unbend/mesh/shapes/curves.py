"""Space curves parametrised by arc length, and the poses of the demonstration tubes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.integrate import cumulative_simpson
from scipy.interpolate import CubicSpline

from unbend.arrays import Floats
from unbend.errors import ParameterError
from unbend.mesh.shapes.checks import one_of, positive

SAMPLES = 4001
"""Number of sample points of a curve. If the curve turns by 20 radians, its speed is wrong by about 1e-6."""


@dataclass(frozen=True, eq=False)
class SpaceCurve:
    """A smooth space curve of unit speed.

    Parameters
    ----------
    length : float
        Arc length.
    spline : CubicSpline
        The point as a function of the arc length, from 0 to `length`. `SpaceCurve.through` makes it.
    """

    length: float
    spline: CubicSpline

    @classmethod
    def through(cls, points: Floats, *, length: float | None = None) -> SpaceCurve:
        """Return the curve through densely sampled points.

        Parameters
        ----------
        points : (n, 3)
            Samples in order, n >= 4, each different from the next. The arc length is that of the polygon, so the speed
            is wrong by (turning / n)^2 / 24.
        length : float, optional
            Length to which the curve is scaled about the origin.

        Raises
        ------
        ParameterError
            If `points` cannot make a curve, or `length` is not positive.
        """
        points = np.asarray(points, float)
        if points.ndim != 2 or points.shape[1] != 3 or len(points) < 4 or not np.isfinite(points).all():
            raise ParameterError(f"points must be at least 4 finite points in space, not {points.shape}")
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        if steps.min() <= 0:
            raise ParameterError("successive points must differ")
        arc = np.concatenate([[0.0], np.cumsum(steps)])
        scale = 1.0 if length is None else positive("length", length) / arc[-1]
        return cls(float(arc[-1] * scale), CubicSpline(arc * scale, points * scale))

    def points(self, s: Floats) -> Floats:
        """Return the points (n, 3) at the arc lengths s (n,)."""
        return np.asarray(self.spline(s), float)

    def tangents(self, s: Floats) -> Floats:
        """Return the unit tangents (n, 3) at the arc lengths s (n,)."""
        slopes = np.asarray(self.spline(s, 1), float)
        return np.asarray(slopes / np.linalg.norm(slopes, axis=1, keepdims=True), float)


def _turning(tangent_angle: Callable[[Floats], Floats]) -> Callable[[Floats], Floats]:
    """Return the plane curve whose tangent has the angle `tangent_angle` at each parameter from 0 to 1."""

    def points(p: Floats) -> Floats:
        angle = tangent_angle(p)
        directions = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)])
        return np.asarray(cumulative_simpson(directions, x=p, axis=1, initial=0).T, float)

    return points


def _helix(p: Floats) -> Floats:
    angle = 2 * math.pi * 2 * p
    return np.stack([np.cos(angle), np.sin(angle), 0.25 * angle], axis=1)


def _loop(p: Floats) -> Floats:
    """Return one and a half turns about z that also rise in z and drift in y."""
    angle = 2 * math.pi * 1.5 * p
    return np.stack([np.cos(angle), np.sin(angle) + 1.6 * p, 2.2 * p], axis=1)


def _knot(p: Floats) -> Floats:
    """Return the trefoil (sin t + 2.5 sin 2t, cos t - 2.5 cos 2t, -1.4 sin 3t) without a quarter of it.

    Among the coefficients tried, these keep the parts of the curve farthest from each other.
    """
    t = 2 * math.pi * (0.12 + 0.76 * p)
    x, y = np.sin(t) + 2.5 * np.sin(2 * t), np.cos(t) - 2.5 * np.cos(2 * t)
    return np.stack([x, y, -1.4 * np.sin(3 * t)], axis=1)


_POSES: dict[str, Callable[[Floats], Floats]] = {
    "straight": _turning(np.zeros_like),
    "arc": _turning(lambda p: 1.3 * math.pi * p),
    "s": _turning(lambda p: 1.9 * np.sin(2 * math.pi * p)),  # a sine-generated curve, the shape of river meanders
    "wave": _turning(lambda p: 1.3 * np.cos(4 * math.pi * p)),
    "spiral": _turning(lambda p: 6.2 * p**1.8),
    "helix": _helix,
    "loop": _loop,
    "knot": _knot,
}

TUBE_POSES: tuple[str, ...] = tuple(_POSES)
"""The poses that `pose_curve` and `bent_tube` know."""


def pose_curve(pose: str, *, length: float = 5.0) -> SpaceCurve:
    """Return the curve of a named pose.

    Parameters
    ----------
    pose : str
        One of `TUBE_POSES`.
    length : float, default 5.0
        Its arc length.

    Raises
    ------
    ParameterError
        If there is no such pose, or the length is not positive.
    """
    points = _POSES[one_of("pose", pose, TUBE_POSES)](np.linspace(0.0, 1.0, SAMPLES))
    return SpaceCurve.through(points, length=length)
