"""What paths and contours share: lists of points on the surface."""

from __future__ import annotations

import numpy as np

from unbend.arrays import Bools, Floats


def without_repeats(points: Floats) -> Floats:
    """Leave out repeated points, as where a line crosses all the edges that meet in a vertex."""
    keep: Bools = np.append(True, (points[1:] != points[:-1]).any(axis=1))
    return points[keep]
