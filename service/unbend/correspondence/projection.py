"""The nearest point of a surface that is embedded in many dimensions: a face, and a place in it."""

from __future__ import annotations

import numpy as np

from unbend.arrays import Floats, Indices, Ints, Singles
from unbend.jit import kernel


def project(points: Singles, nearest: Indices, vertices: Singles, faces: Ints) -> tuple[Ints, Floats]:
    """Return the nearest point to each of `points` (m, d) on the faces around its `nearest` vertex.

    Parameters
    ----------
    points : (m, d) float32
    nearest : (m,) int64
        A vertex for each point.
    vertices : (n, d) float32
    faces : (f, 3) int32
        Each vertex has at least one.

    Returns
    -------
    faces : (m,) int32
    barycentric : (m, 3) float64
        None is negative, and they sum to 1.
    """
    order = np.argsort(faces.ravel(), kind="stable")
    starts = np.searchsorted(faces.ravel()[order], np.arange(len(vertices) + 1))
    found, places = np.empty(len(points), np.int32), np.empty((len(points), 3))
    _project_each(points, nearest, vertices, faces, order, starts, found, places)
    return found, places


@kernel
def _project_each(points, nearest, vertices, faces, order, starts, found, places):
    gram, ends = np.empty((3, 3)), np.empty(3)
    for row in range(len(points)):
        best = np.inf
        for index in range(starts[nearest[row]], starts[nearest[row] + 1]):
            face = order[index] // 3
            _differences(points[row], vertices, faces[face], gram)
            squared = closest(gram, ends)
            if squared < best:
                best = squared
                found[row] = face
                places[row] = ends


@kernel
def _differences(point, vertices, face, gram):
    """Set `gram` to the inner products of the three vectors from the point to the corners."""
    for i in range(3):
        for j in range(i, 3):
            total = 0.0
            for axis in range(len(point)):
                total += (vertices[face[i], axis] - point[axis]) * (vertices[face[j], axis] - point[axis])
            gram[i, j] = total
            gram[j, i] = total


@kernel
def closest(gram, ends):
    """Set `ends` to the weights of the point of a triangle that is nearest to the origin; return its squared distance.

    `gram` has the inner products of the corners. If the nearest point of the plane is outside, one of the edges has
    the nearest point.
    """
    a = gram[1, 1] - 2 * gram[0, 1] + gram[0, 0]
    b = gram[1, 2] - gram[0, 1] - gram[0, 2] + gram[0, 0]
    c = gram[2, 2] - 2 * gram[0, 2] + gram[0, 0]
    d, e = gram[0, 0] - gram[0, 1], gram[0, 0] - gram[0, 2]
    area = a * c - b * b
    if area > 1e-12 * a * c:
        s, t = (c * d - b * e) / area, (a * e - b * d) / area
        if s >= 0.0 and t >= 0.0 and s + t <= 1.0:
            ends[0], ends[1], ends[2] = max(1.0 - s - t, 0.0), s, t
            return max(gram[0, 0] - s * d - t * e, 0.0)
    best = np.inf
    for i in range(3):
        j = (i + 1) % 3
        length = gram[i, i] - 2 * gram[i, j] + gram[j, j]
        share = 0.0 if length <= 0.0 else min(max((gram[i, i] - gram[i, j]) / length, 0.0), 1.0)
        squared = gram[i, i] - 2 * share * (gram[i, i] - gram[i, j]) + share * share * length
        if squared < best:
            best = squared
            ends[:] = 0.0
            ends[i], ends[j] = 1.0 - share, share
    return max(best, 0.0)
