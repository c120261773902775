"""Soft shadows where light from around hardly reaches: in folds, and where parts meet."""

from __future__ import annotations

from typing import Final

import numpy as np

from unbend.jit import kernel

REACH: Final = 0.05
"""Distance, as a share of the picture's shorter side, within which parts of the surface shade each other."""

_STRENGTH: Final = 0.85
_DIRECTIONS: Final = 8  # and as many opposite ones
_STEPS: Final = 4  # along each


@kernel
def darken(first, stop, depth, coverage, per_length, reach, light):
    """Fill rows of `light` (h, w): the share of the light from around that reaches each pixel.

    In each of eight directions and its opposite, the horizon is where the surface rises steepest towards the eye.
    Opposite horizons of a plane add up to nothing, however it is turned, so no normals are needed.

    Parameters
    ----------
    depth : (h, w)
        Towards the eye, -inf where there is no surface.
    per_length : float
        Pixels for a unit of depth.
    reach : float
        Pixels.
    """
    height, width = depth.shape
    for row in range(first, stop):
        for column in range(width):
            light[row, column] = 1.0
            if coverage[row, column] == 0:
                continue
            here = depth[row, column]
            # Each pixel turns its directions, so that steps do not show as rings; the pattern repeats every 4 x 4.
            shift = ((row * 4 + column * 9) % 16) / 16.0
            closed = 0.0
            for number in range(_DIRECTIONS):
                angle = np.pi * (number + shift) / _DIRECTIONS
                dx, dy = np.cos(angle), np.sin(angle)
                both = 0.0
                for sign in (-1.0, 1.0):
                    steepest = -2.0
                    for step in range(1, _STEPS + 1):
                        length = reach * (step - 0.5 + 0.5 * shift) / _STEPS
                        x = int(np.floor(column + 0.5 + sign * dx * length))
                        y = int(np.floor(row + 0.5 + sign * dy * length))
                        if x < 0 or y < 0 or x >= width or y >= height or coverage[y, x] == 0:
                            continue
                        rise = (depth[y, x] - here) * per_length
                        if rise > 3.0 * reach:
                            continue  # something far in front, which does not touch
                        slope = rise / length
                        steepest = max(steepest, slope / np.sqrt(1.0 + slope * slope) if slope > -2.0 else -0.9)
                    both += max(steepest, -0.9)
                closed += min(max(both, 0.0), 1.6)
            light[row, column] = 1.0 - _STRENGTH * min(closed / (1.6 * _DIRECTIONS), 1.0)


@kernel
def smooth(first, stop, depth, coverage, per_length, light, smoothed):
    """Fill rows of `smoothed` (h, w): the mean of `light` over the 4 x 4 pixels of its pattern, on one surface each."""
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
