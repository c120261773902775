"""The roughness of a surface: a number that distinguishes noise from shape."""

from __future__ import annotations

from typing import Final

import numpy as np

from unbend.arrays import Floats, Indices, Ints
from unbend.jit import kernel
from unbend.mesh.areas import triangle_areas
from unbend.mesh.smooth import SHRINK, SWELL, boundary_edges
from unbend.mesh.surface import Surface

ROUGH: Final = 0.02
"""Roughness above which a surface counts as rough.

It was chosen on the meshes in the table that benchmarks/retrieval/robustness.py prints: twice the roughness of the
roughest clean mesh, and less than that of any mesh of at least 20 vertices with noise of 0.3 edges. The analytic shapes
of the tests agree with it, and were not used for the choice.
"""


def roughness(surface: Surface) -> float:
    """Return a rough estimate of the share of noise in the area of `surface`, 0 to 1.

    Noise has two properties. First, the surface bends at many vertices in the direction opposite to its neighbourhood.
    Half of all bending does so in noise of any strength, but hardly any on a shape with fine enough triangles. Second,
    noise has area, which a round of smoothing removes; but smoothing also rounds edges. The result is the product of
    both shares, so it is small for a shape of few triangles and for weak noise. Boundaries are ignored.
    """
    points, faces, neighbours = _placed(surface), surface.faces, _neighbour_counts(surface)
    towards = _towards_means(points, faces, neighbours)
    bending = (towards * _normals(points, faces)).sum(axis=0)
    around = _sums_of_others(bending[None], faces)[0]
    total = float(np.abs(bending).sum())
    if total == 0:
        return 0.0
    against = float(np.abs(bending[bending * around < 0]).sum()) / total
    points += SHRINK * towards
    points += SWELL * _towards_means(points, faces, neighbours)
    left = float(triangle_areas(np.ascontiguousarray(points.T), faces, 1.0).sum()) * surface.scale**2 / surface.area
    return against * max(0.0, 1.0 - left)


# Below, arrays of vertices have one row for each axis, because kernels took several times as long with rows of three.


def _placed(surface: Surface) -> Floats:
    """Return the vertices scaled to an extent of about 1 near the origin, (3, n); unused ones are at the origin."""
    used = surface.used_vertices
    placed = (surface.vertices[used] - surface.vertices[used[0]]) / surface.scale
    if len(used) == len(surface.vertices):
        return np.ascontiguousarray(placed.T)
    points = np.zeros((3, len(surface.vertices)))
    points[:, used] = placed.T
    return points


def _neighbour_counts(surface: Surface) -> Indices:
    """Return twice the number of neighbours, because each is counted in two faces, (n,); 0 at boundaries."""
    counts = 2 * np.bincount(surface.faces.ravel(), minlength=len(surface.vertices))
    counts[boundary_edges(surface)] = 0
    return counts


def _towards_means(points: Floats, faces: Ints, neighbours: Indices) -> Floats:
    """Return the vector from each vertex to the mean of its neighbours, (3, n); zero at boundaries."""
    means = _sums_of_others(points, faces) / np.maximum(neighbours, 1)
    return np.where(neighbours > 0, means - points, 0.0)


def _sums_of_others(values: Floats, faces: Ints) -> Floats:
    sums = np.zeros_like(values)
    _add_others(values, faces, sums)
    return sums


def _normals(points: Floats, faces: Ints) -> Floats:
    normals = np.zeros_like(points)
    _add_normals(points, faces, normals)
    lengths = np.sqrt((normals**2).sum(axis=0))
    return normals / np.where(lengths > 0, lengths, 1.0)


@kernel
def _add_others(values: Floats, faces: Ints, sums: Floats) -> None:
    """Add to each vertex the values (k, n) of the other two vertices of each of its faces."""
    for row in range(len(values)):
        for face in range(len(faces)):
            a, b, c = faces[face]
            x, y, z = values[row, a], values[row, b], values[row, c]
            sums[row, a] += y + z
            sums[row, b] += z + x
            sums[row, c] += x + y


@kernel
def _add_normals(points: Floats, faces: Ints, normals: Floats) -> None:
    """Add to each vertex the area normals of its faces."""
    for face in range(len(faces)):
        a, b, c = faces[face]
        ux, uy, uz = points[0, b] - points[0, a], points[1, b] - points[1, a], points[2, b] - points[2, a]
        vx, vy, vz = points[0, c] - points[0, a], points[1, c] - points[1, a], points[2, c] - points[2, a]
        x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        # A loop over the corners takes five times as long.
        normals[0, a] += x
        normals[1, a] += y
        normals[2, a] += z
        normals[0, b] += x
        normals[1, b] += y
        normals[2, b] += z
        normals[0, c] += x
        normals[1, c] += y
        normals[2, c] += z
