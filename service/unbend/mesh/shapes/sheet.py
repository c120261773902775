"""A flat sheet and its exact isometric bendings: developable surfaces swept from unit-speed plane curves."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypedDict, Unpack

import numpy as np
from scipy.optimize import brentq

from unbend.arrays import Floats
from unbend.errors import ParameterError
from unbend.mesh.shapes.checks import at_least, between, one_of, positive
from unbend.mesh.shapes.grids import TRIANGULATIONS, Triangulation, grid_faces, grid_parameters
from unbend.mesh.surface import Surface

PlaneCurve = Callable[[Floats], tuple[Floats, Floats]]
"""Function from the arc length (n,) to the coordinates x (n,) and z (n,) of a curve of unit speed."""

FULL_TURN = 0.99 * 2 * math.pi
"""Largest angle of an arc. A full circle would bring the edges of the sheet together."""


class SheetGrid(TypedDict, total=False):
    """The arguments of `sheet`, which every bent sheet also takes."""

    width: float
    height: float
    columns: int
    rows: int
    triangulation: Triangulation
    shear: float


def sheet(
    width: float = 2.0,
    height: float = 1.0,
    *,
    columns: int = 40,
    rows: int = 20,
    triangulation: Triangulation = "alternating",
    shear: float = 0.0,
) -> Surface:
    """Return a flat sheet in the plane z = 0.

    Parameters
    ----------
    width, height : float, default 2.0 and 1.0
        Sides along x and y.
    columns, rows : int, default 40 and 20
        Cells along x and y. Each cell is split into two triangles.
    triangulation : {"alternating", "uniform"}
        Directions of the cells' diagonals: alternating like the colours of a chessboard, or all equal.
    shear : float, default 0.0
        Adds `shear * y` to x, which makes a parallelogram with obtuse triangles and the same area.

    Returns
    -------
    Surface
        With (columns + 1) * (rows + 1) vertices, and 2 * columns * rows faces with normals along +z.

    Raises
    ------
    ParameterError
        If a side is not positive, a count is below 1, or another argument is out of its range.
    """
    positive("width", width)
    positive("height", height)
    columns, rows = at_least("columns", columns, 1), at_least("rows", rows, 1)
    one_of("triangulation", triangulation, TRIANGULATIONS)
    between("shear", shear, -10.0, 10.0)
    u, v = grid_parameters(columns, rows)
    vertices = np.stack([width * u + shear * height * v, height * v, np.zeros_like(u)], axis=1)
    return Surface(vertices, grid_faces(columns, rows, triangulation=triangulation))


def bend(flat: Surface, curve: PlaneCurve) -> Surface:
    """Bend a flat surface onto the cylinder over a plane curve of unit speed.

    The point (x, y, 0) moves to (X(s), y, Z(s)) with s = x - min(x). Because X'^2 + Z'^2 = 1, the map from the plane to
    the bent surface is an isometry: it keeps the intrinsic distance of any two points. The edges of the triangles are
    chords of the bent surface, so they are shorter by O(edge^3).

    Parameters
    ----------
    flat : Surface
        A surface in the plane z = 0.
    curve : callable
        Function s (n,) -> (X (n,), Z (n,)) of unit speed.

    Returns
    -------
    Surface
        The same faces with bent vertices.
    """
    x, z = curve(flat.vertices[:, 0] - flat.vertices[:, 0].min())
    return Surface(np.stack([x, flat.vertices[:, 1], z], axis=1), flat.faces)


def cylinder(angle: float = 1.5 * math.pi, **grid: Unpack[SheetGrid]) -> Surface:
    """Return the sheet with its width bent to a circular arc of `angle` radians.

    Parameters
    ----------
    angle : float, default 1.5 pi
        Above 0 and at most 0.99 * 2 pi, so that the edges never meet.
    **grid
        As in `sheet`.

    Raises
    ------
    ParameterError
        If `angle` is out of its range, or as `sheet` does.
    """
    between("angle", positive("angle", angle), 0.0, FULL_TURN)
    flat = sheet(**grid)
    return bend(flat, _arc(_extent(flat) / angle))


def s_bend(angle: float = math.pi, **grid: Unpack[SheetGrid]) -> Surface:
    """Return the sheet bent like an S: half of its width turns by `angle` one way, half the other way.

    Parameters
    ----------
    angle : float, default pi
        Turning angle of each half in radians, above 0 and at most 0.99 * 2 pi.
    **grid
        As in `sheet`.

    Raises
    ------
    ParameterError
        If `angle` is out of its range, or as `sheet` does.
    """
    between("angle", positive("angle", angle), 0.0, FULL_TURN)
    flat = sheet(**grid)
    half = _extent(flat) / 2
    arc = _arc(half / angle)

    def curve(s: Floats) -> tuple[Floats, Floats]:
        # The second half is the first one turned by pi about the middle, where both are tangent to x.
        x, z = arc(np.abs(s - half))
        side = np.sign(s - half)
        return side * x, side * z

    return bend(flat, curve)


def spiral(turns: float = 1.5, gap: float = 0.1, **grid: Unpack[SheetGrid]) -> Surface:
    """Return the sheet rolled up along an Archimedean spiral r = r0 + gap * theta / (2 pi).

    The arc length is s(r) = (r sqrt(r^2 + b^2) + b^2 asinh(r / b)) / (2 b) with b = gap / (2 pi). The radius r0 is
    chosen so that `turns` turns take the whole width.

    Parameters
    ----------
    turns : float, default 1.5
        Full turns of the spiral, from 0.1 to 50.
    gap : float, default 0.1
        Distance between layers along a radius, in the unit of the sheet.
    **grid
        As in `sheet`.

    Raises
    ------
    ParameterError
        If the width is too short for so many turns with such a gap, or as `sheet` does.
    """
    between("turns", turns, 0.1, 50.0)
    positive("gap", gap)
    flat = sheet(**grid)
    length, b, sweep = _extent(flat), gap / (2 * math.pi), 2 * math.pi * turns
    # Below a radius of one gap the innermost layer would crowd the axis.
    shortest = _spiral_length(gap + b * sweep, b) - _spiral_length(gap, b)
    if shortest >= length:
        raise ParameterError(f"turns * gap is too large: {turns} turns take a width above {shortest:.4g}")
    start = brentq(
        lambda r: float(_spiral_length(r + b * sweep, b) - _spiral_length(r, b) - length),
        gap,
        length / sweep + gap,
        xtol=1e-14,
    )
    return bend(flat, _archimedean(float(start), b))


def _extent(flat: Surface) -> float:
    return float(np.ptp(flat.vertices[:, 0]))


def _arc(radius: float) -> PlaneCurve:
    return lambda s: (radius * np.sin(s / radius), radius * (1 - np.cos(s / radius)))


def _spiral_length(r: float | Floats, b: float) -> Floats:
    return np.asarray((r * np.sqrt(np.square(r) + b * b) + b * b * np.arcsinh(np.divide(r, b))) / (2 * b))


def _archimedean(start: float, b: float) -> PlaneCurve:
    def curve(s: Floats) -> tuple[Floats, Floats]:
        target = s + _spiral_length(start, b)
        r = np.sqrt(start**2 + 2 * b * s)  # the arc length when b << r: ds = r dtheta = r dr / b
        for _ in range(8):  # Newton; ds/dr = sqrt(r^2 + b^2) / b
            r = r - (_spiral_length(r, b) - target) * b / np.hypot(r, b)
        theta = (r - start) / b
        return r * np.cos(theta), r * np.sin(theta)

    return curve
