"""The growth of geodesic circles: the area within each of several distances from a point."""

from __future__ import annotations

from unbend.arrays import Floats, Ints
from unbend.jit import kernel


@kernel
def add_growth(distances: Floats, faces: Ints, areas: Floats, radii: Floats, growth: Floats) -> None:
    """Add to `growth` (k, r) the area nearer than each of `radii` (r,), rising, for each row of `distances` (k, n).

    Distances are linear in each triangle, so a circle cuts a triangle along a straight line, and the area on its near
    side is exact.
    """
    for row in range(len(distances)):
        for face in range(len(faces)):
            a = distances[row, faces[face, 0]]
            b = distances[row, faces[face, 1]]
            c = distances[row, faces[face, 2]]
            low, high = min(a, b, c), max(a, b, c)
            middle = max(min(a, b), min(max(a, b), c))
            for index in range(len(radii) - 1, -1, -1):
                radius = radii[index]
                if radius <= low:
                    break
                if radius >= high:
                    growth[row, index] += areas[face]
                elif radius <= middle:
                    growth[row, index] += areas[face] * (radius - low) ** 2 / ((middle - low) * (high - low))
                else:
                    growth[row, index] += areas[face] * (1.0 - (high - radius) ** 2 / ((high - middle) * (high - low)))
