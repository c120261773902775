"""Areas of triangles."""

from __future__ import annotations

import numpy as np

from unbend.arrays import Floats, Ints
from unbend.jit import kernel


def triangle_areas(vertices: Floats, faces: Ints, scale: float) -> Floats:
    """Return the area of each of `faces` (m, 3), as (m,); `scale` is the surface's `scale`."""
    # The square of a cross product is a fourth power of lengths. Scaling keeps it within the range of double precision.
    areas = np.empty(len(faces))
    _fill_areas(vertices, faces, scale, areas)
    return areas


@kernel
def _fill_areas(vertices: Floats, faces: Ints, scale: float, areas: Floats) -> None:
    for face in range(len(faces)):
        a, b, c = faces[face]
        ux = (vertices[b, 0] - vertices[a, 0]) / scale
        uy = (vertices[b, 1] - vertices[a, 1]) / scale
        uz = (vertices[b, 2] - vertices[a, 2]) / scale
        vx = (vertices[c, 0] - vertices[a, 0]) / scale
        vy = (vertices[c, 1] - vertices[a, 1]) / scale
        vz = (vertices[c, 2] - vertices[a, 2]) / scale
        x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        areas[face] = 0.5 * np.sqrt(x * x + y * y + z * z) * scale * scale
