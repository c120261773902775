"""Normals at the corners of faces: smooth on curved parts, sharp at creases, whatever the faces' orientation."""

from __future__ import annotations

from typing import Final

import numpy as np

from unbend.arrays import Floats, Ints, Singles
from unbend.jit import kernel
from unbend.threads import share_out

CREASE: Final = 0.4
"""Cosine of the angle, 66 degrees, from which two faces at a vertex are shaded apart."""


def corner_normals(vertices: Floats, faces: Ints, threads: int | None = None) -> Singles:
    """Return a unit normal for each corner of each face, (m, 3, 3) float32, on the side of the face's own normal.

    Each normal of a face at the vertex is first turned to the side of the face's own. The result is the mean, by area,
    of those that then differ from it by less than 66 degrees. So meshes of any orientation are smooth, and edges of
    solids sharp. It is zero at faces without an area.
    """
    starts, order = _faces_at_vertices(faces, len(vertices))
    flat, units = _face_normals(vertices, faces)
    normals = np.empty((len(faces), 3, 3), np.float32)
    share_out(
        len(faces), threads, lambda part: _fill(part.start, part.stop, faces, starts, order, flat, units, normals)
    )
    return normals


@kernel
def _faces_at_vertices(faces, count):
    starts = np.zeros(count + 1, np.int64)
    for face in range(len(faces)):
        for corner in range(3):
            starts[faces[face, corner] + 1] += 1
    for vertex in range(count):
        starts[vertex + 1] += starts[vertex]
    order, place = np.empty(3 * len(faces), np.int32), starts.copy()
    for face in range(len(faces)):
        for corner in range(3):
            vertex = faces[face, corner]
            order[place[vertex]] = face
            place[vertex] += 1
    return starts, order


@kernel
def _face_normals(vertices, faces):
    """Return normals as long as twice the area, and unit normals."""
    flat, units = np.empty((len(faces), 3)), np.zeros((len(faces), 3))
    for face in range(len(faces)):
        a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
        ux, uy, uz = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
        vx, vy, vz = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
        x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        flat[face, 0], flat[face, 1], flat[face, 2] = x, y, z
        size = np.sqrt(x * x + y * y + z * z)
        if size > 0:
            units[face, 0], units[face, 1], units[face, 2] = x / size, y / size, z / size
    return flat, units


@kernel
def _fill(first, stop, faces, starts, order, flat, units, normals):
    for face in range(first, stop):
        nx, ny, nz = units[face, 0], units[face, 1], units[face, 2]
        for corner in range(3):
            vertex = faces[face, corner]
            x = y = z = 0.0
            for place in range(starts[vertex], starts[vertex + 1]):
                other = order[place]
                along = nx * units[other, 0] + ny * units[other, 1] + nz * units[other, 2]
                if abs(along) > CREASE:
                    side = 1.0 if along > 0 else -1.0
                    x += side * flat[other, 0]
                    y += side * flat[other, 1]
                    z += side * flat[other, 2]
            size = np.sqrt(x * x + y * y + z * z)
            if size > 0:
                x, y, z = x / size, y / size, z / size
            normals[face, corner, 0], normals[face, corner, 1], normals[face, corner, 2] = x, y, z
