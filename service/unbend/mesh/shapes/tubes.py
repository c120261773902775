"""Closed tubes along space curves: nearly the same intrinsic shape in many poses."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from unbend.arrays import Floats, Indices
from unbend.errors import ParameterError
from unbend.mesh.shapes.checks import at_least, positive
from unbend.mesh.shapes.curves import SpaceCurve, pose_curve
from unbend.mesh.shapes.grids import grid_faces
from unbend.mesh.surface import Surface

Radius = float | Callable[[Floats], Floats]
"""A constant, or a function of the arc lengths (n,) that returns the radii (n,)."""


def tube(curve: SpaceCurve, radius: Radius = 0.15, *, around: int = 16, along: int | None = None) -> Surface:
    """Return a closed tube along a curve, with hemispherical caps.

    The cross-sections are circles in a rotation-minimising frame (Wang, Juettler, Zheng & Liu 2008, "Computation
    of rotation minimizing frames", the double reflection method), so the grid does not twist. A tube of constant
    radius r has the area 2 pi r L + 4 pi r^2 whatever the curve, as long as r * curvature < 1 (Pappus).

    Parameters
    ----------
    curve : SpaceCurve
        The axis.
    radius : float or callable, default 0.15
        Radius in the unit of the curve; see `Radius`. The caps join smoothly if the radius has slope 0 at the ends.
    around : int, default 16
        Vertices of each cross-section, at least 6.
    along : int, optional
        Cells along the axis without the caps, at least 2. By default the cells are nearly square.

    Returns
    -------
    Surface
        Closed, of Euler characteristic 2, with outward normals.

    Raises
    ------
    ParameterError
        If a radius is not positive, or the tube would touch or fold into itself.
    """
    around = at_least("around", around, 6)
    mean = float(np.mean(_radii(radius, np.linspace(0.0, curve.length, 200))))
    along = max(2, round(curve.length * around / (2 * math.pi * mean))) if along is None else along
    s = np.linspace(0.0, curve.length, at_least("along", along, 2) + 1)
    centres, tangents, radii = curve.points(s), curve.tangents(s), _radii(radius, s)
    _check_clear(s, centres, tangents, radii)
    normals = _rotation_minimising(centres, tangents)
    rings = _with_caps(centres, tangents, normals, radii, caps=max(2, around // 4))
    return _closed(*rings, around)


def bent_tube(
    pose: str = "straight",
    *,
    length: float = 5.0,
    radius: Radius = 0.15,
    around: int = 16,
    along: int | None = None,
) -> Surface:
    """Return the tube of a given length and radius in a named pose.

    Parameters
    ----------
    pose : str, default "straight"
        One of `TUBE_POSES`.
    length : float, default 5.0
        Length of the axis without the caps.
    radius, around, along
        As in `tube`.

    Raises
    ------
    ParameterError
        If there is no such pose, or as `tube` does. The knot needs a length of about 30 radii.
    """
    return tube(pose_curve(pose, length=length), radius, around=around, along=along)


def pin_profile(length: float = 4.0, radius: float = 0.26) -> Callable[[Floats], Floats]:
    """Return the radii of a bowling pin: a belly of `radius`, a neck of 0.35 of it and a head of 0.65.

    Raises
    ------
    ParameterError
        If an argument is not positive.
    """
    return _profile(length, radius, [0.0, 0.3, 0.68, 0.92, 1.0], [0.7, 1.0, 0.35, 0.65, 0.6])


def worm_profile(length: float = 5.0, radius: float = 0.2, segments: int = 6) -> Callable[[Floats], Floats]:
    """Return the radii of a worm: `segments` bulges of `radius`, with waists of 0.55 of it between them.

    Raises
    ------
    ParameterError
        If an argument is out of its range.
    """
    count = at_least("segments", segments, 1, 100)
    waists = np.where(np.arange(2 * count + 1) % 2 == 1, 1.0, 0.55)
    return _profile(length, radius, np.linspace(0.0, 1.0, 2 * count + 1).tolist(), waists.tolist())


def _profile(length: float, radius: float, knots: list[float], shares: list[float]) -> Callable[[Floats], Floats]:
    """Return a function through the knots that has slope 0 at each (cosine steps), so that it never overshoots."""
    positions, heights = (
        positive("length", length) * np.array(knots),
        positive("radius", radius) * np.array(shares),
    )

    def radii(s: Floats) -> Floats:
        piece = np.clip(np.searchsorted(positions, s, side="right") - 1, 0, len(positions) - 2)
        share = (s - positions[piece]) / (positions[piece + 1] - positions[piece])
        blend = (1 - np.cos(math.pi * np.clip(share, 0, 1))) / 2
        return np.asarray(heights[piece] * (1 - blend) + heights[piece + 1] * blend, float)

    return radii


def _radii(radius: Radius, s: Floats) -> Floats:
    radii = np.broadcast_to(np.asarray(radius(s) if callable(radius) else radius, float), s.shape)
    if not (np.isfinite(radii).all() and radii.min() > 0):
        raise ParameterError("radius must be finite and above 0 everywhere")
    return radii


def _check_clear(s: Floats, centres: Floats, tangents: Floats, radii: Floats) -> None:
    """Raise ParameterError if the tube folds (curvature above 1 / radius) or touches itself."""
    turning = np.arccos(np.clip((tangents[1:] * tangents[:-1]).sum(axis=1), -1, 1))
    if (turning * np.maximum(radii[1:], radii[:-1]) >= np.diff(s)).any():
        raise ParameterError("the curve bends more sharply than the radius allows")
    reach = radii[:, None] + radii
    apart = np.linalg.norm(centres[:, None] - centres, axis=2)
    # On a circle of the smallest radius allowed, points pi r apart along the curve are 2 r apart in space.
    if ((np.abs(s[:, None] - s) > math.pi / 2 * reach) & (apart <= reach)).any():
        raise ParameterError("the tube would touch itself: take a smaller radius or a longer curve")


def _rotation_minimising(centres: Floats, tangents: Floats) -> Floats:
    """Return a unit normal at each centre, (n, 3), by double reflection (Wang et al. 2008, table I)."""
    normals = np.empty_like(centres)
    start = np.cross(tangents[0], np.eye(3)[np.argmin(np.abs(tangents[0]))])
    normals[0] = start / np.linalg.norm(start)
    for i in range(len(centres) - 1):
        step = centres[i + 1] - centres[i]
        share = 2 / (step @ step)
        normal = normals[i] - share * (step @ normals[i]) * step
        tangent = tangents[i] - share * (step @ tangents[i]) * step
        turn = tangents[i + 1] - tangent
        size = turn @ turn
        normals[i + 1] = normal - (2 / size * (turn @ normal) * turn if size > 0 else 0)
    return normals


def _with_caps(
    centres: Floats, tangents: Floats, normals: Floats, radii: Floats, *, caps: int
) -> tuple[Floats, Floats, Floats, Floats]:
    """Add `caps` rings at each end, which shrink to the poles. Each pole is a ring of radius 0."""
    angle = np.arange(1, caps + 1)[:, None] * math.pi / (2 * caps)
    cosine = np.cos(angle).ravel()
    cosine[-1] = 0.0
    first = centres[0] - radii[0] * np.sin(angle) * tangents[0]
    last = centres[-1] + radii[-1] * np.sin(angle) * tangents[-1]

    def repeated(rows: Floats) -> Floats:
        return np.concatenate([np.repeat(rows[:1], caps, 0), rows, np.repeat(rows[-1:], caps, 0)])

    ring_radii = np.concatenate([radii[0] * cosine[::-1], radii, radii[-1] * cosine])
    return np.concatenate([first[::-1], centres, last]), repeated(tangents), repeated(normals), ring_radii


def _closed(centres: Floats, tangents: Floats, normals: Floats, radii: Floats, around: int) -> Surface:
    """Join rings of `around` vertices into a tube; the first and the last ring are single vertices."""
    angle = np.arange(around)[:, None] * 2 * math.pi / around
    binormals = np.cross(tangents, normals)
    inner = slice(1, -1)
    circles = np.cos(angle) * normals[inner, None] + np.sin(angle) * binormals[inner, None]  # (rings, around, 3)
    rings = centres[inner, None] + radii[inner, None, None] * circles
    vertices = np.vstack([centres[:1], rings.reshape(-1, 3), centres[-1:]])
    band = 1 + grid_faces(around, len(rings) - 1, periodic=(True, False))
    return Surface(vertices, np.vstack([band, _fans(around, len(rings))]))


def _fans(around: int, rings: int) -> Indices:
    """Return the triangles around the two poles, vertices 0 and 1 + rings * around."""
    here = np.arange(around)
    after = (here + 1) % around
    first = np.stack([np.zeros_like(here), 1 + after, 1 + here], axis=1)
    base, pole = 1 + (rings - 1) * around, 1 + rings * around
    last = np.stack([np.full_like(here, pole), base + here, base + after], axis=1)
    return np.vstack([first, last])
