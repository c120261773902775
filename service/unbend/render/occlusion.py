"""Soft shadows where light from around hardly reaches: in folds, and where parts meet."""

from __future__ import annotations

from typing import Final

import numpy as np

from unbend.arrays import Floats, Ints
from unbend.jit import kernel

REACH: Final = 0.05
"""Distance, as a share of the picture's shorter side, within which parts of the surface shade each other."""

_STRENGTH: Final = 0.85
_DIRECTIONS: Final = 6  # and as many opposite ones
_STEPS: Final = 4  # along each
_PATTERN: Final = 4  # the directions of pixels repeat after this many rows and columns
_LOWEST: Final = -0.9  # sine of the horizon where nothing is
_MOST: Final = 1.6  # largest sum of two opposite horizons that counts


def places_around(reach: float) -> tuple[Ints, Floats]:
    """Return the places that each pixel of the pattern looks at, and how far they are.

    Parameters
    ----------
    reach : float
        Pixels.

    Returns
    -------
    (16, 6, 2, 4, 2) int32, (16, 4) float64
        Columns and rows from the pixel, for each direction, its opposite, and each step; and the steps' lengths.
    """
    shift = np.arange(_PATTERN**2) / _PATTERN**2  # each pixel turns its directions, so that steps do not show as rings
    angles = np.pi * (np.arange(_DIRECTIONS) + shift[:, None]) / _DIRECTIONS
    lengths = reach * (np.arange(1, _STEPS + 1) - 0.5 + 0.5 * shift[:, None]) / _STEPS
    unit = np.stack([np.cos(angles), np.sin(angles)], axis=-1)[:, :, None, None]
    signs = np.array([-1.0, 1.0])[:, None, None]
    return np.floor(0.5 + unit * signs * lengths[:, None, None, :, None]).astype(np.int32), lengths


@kernel
def darken(first, stop, depth, coverage, per_length, reach, places, lengths, light):
    """Fill rows of `light` (h, w): the share of the light from around that reaches each pixel.

    In each direction and its opposite, the horizon is where the surface rises steepest towards the eye. Opposite
    horizons of a plane add up to nothing, however it is turned, so no normals are needed.

    Parameters
    ----------
    depth : (h, w)
        Towards the eye, -inf where there is no surface.
    per_length : float
        Pixels for a unit of depth.
    reach : float
        Pixels.
    places, lengths
        As `places_around` returns them.
    """
    height, width = depth.shape
    for row in range(first, stop):
        for column in range(width):
            light[row, column] = 1.0
            if coverage[row, column] == 0:
                continue
            here = depth[row, column]
            turn = (row * _PATTERN + column * 9) % _PATTERN**2
            closed = 0.0
            for direction in range(_DIRECTIONS):
                both = 0.0
                for side in range(2):
                    steepest = _LOWEST
                    for step in range(_STEPS):
                        x = column + places[turn, direction, side, step, 0]
                        y = row + places[turn, direction, side, step, 1]
                        if x < 0 or y < 0 or x >= width or y >= height or coverage[y, x] == 0:
                            continue
                        rise = (depth[y, x] - here) * per_length
                        length = lengths[turn, step]
                        # Points far in front cast no shadow here. The first test avoids most square roots.
                        if rise > steepest * length and rise <= 3.0 * reach:
                            steepest = max(steepest, rise / np.sqrt(length * length + rise * rise))
                    both += steepest
                closed += min(max(both, 0.0), _MOST)
            light[row, column] = 1.0 - _STRENGTH * min(closed / (_MOST * _DIRECTIONS), 1.0)


@kernel
def smooth(first, stop, depth, coverage, per_length, light, smoothed):
    """Fill rows of `smoothed` (h, w): the mean of `light` over 4 x 4 pixels, without pixels at other depths."""
    height, width = depth.shape
    for row in range(first, stop):
        for column in range(width):
            total = weight = 0.0
            for y in range(max(0, row - 2), min(height, row + 2)):
                for x in range(max(0, column - 2), min(width, column + 2)):
                    if coverage[y, x] > 0 and abs(depth[y, x] - depth[row, column]) * per_length < 12.0:
                        total += light[y, x]
                        weight += 1.0
            smoothed[row, column] = total / weight if weight > 0 else 1.0
