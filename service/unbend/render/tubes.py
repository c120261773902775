"""Triangles of tubes and spheres."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from unbend.arrays import Floats, Ints
from unbend.mesh.shapes import sphere

_SIDES: Final = 12
_SHARP: Final = 0.7  # cosine of the angle, 46 degrees, from which a corner is rounded
_SPHERE_SUBDIVISIONS: Final = 3  # 642 vertices


def tube_mesh(points: Floats, radius: float) -> tuple[Floats, Ints]:
    """Return vertices (n, 3) and faces (m, 3) of a tube around a polyline (p, 3), with round ends and corners.

    Its cross-section is carried along without twisting. A single point, or repeats of it, gives a sphere.
    """
    kept = np.append(True, (np.diff(points, axis=0) != 0).any(axis=1))
    line = points[kept]
    if len(line) == 1:
        return ball_mesh(line[0], radius)
    steps = np.diff(line, axis=0)
    steps /= np.linalg.norm(steps, axis=1, keepdims=True)
    sharp = line[1:-1][(steps[1:] * steps[:-1]).sum(axis=1) < _SHARP]
    return joined([_wall(line, steps, radius), *(ball_mesh(point, radius) for point in (line[0], *sharp, line[-1]))])


def ball_mesh(centre: Floats, radius: float) -> tuple[Floats, Ints]:
    """Return vertices (n, 3) and faces (m, 3) of a sphere."""
    unit = sphere(subdivisions=_SPHERE_SUBDIVISIONS)
    return unit.vertices * radius + centre, unit.faces


def joined(meshes: list[tuple[Floats, Ints]]) -> tuple[Floats, Ints]:
    """Return several meshes as one."""
    offsets = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    faces = [faces + offset for (_, faces), offset in zip(meshes, offsets, strict=False)]
    return np.concatenate([vertices for vertices, _ in meshes]), np.concatenate(faces).astype(np.int32)


def _wall(line: Floats, steps: Floats, radius: float) -> tuple[Floats, Ints]:
    first = np.cross(steps[0], np.eye(3)[np.abs(steps[0]).argmin()])
    across = first / np.linalg.norm(first)
    angles = 2 * np.pi * np.arange(_SIDES) / _SIDES
    rings: list[NDArray[np.float64]] = []
    for place, point in enumerate(line):
        before, after = steps[max(place - 1, 0)], steps[min(place, len(steps) - 1)]
        along = before + after
        size = np.linalg.norm(along)
        along = along / size if size > 1e-6 else after  # a hairpin has no direction between
        across = across - (across @ along) * along
        size = np.linalg.norm(across)
        across = across / size if size > 1e-6 else np.cross(along, np.eye(3)[np.abs(along).argmin()])
        across = across / np.linalg.norm(across)
        other = np.cross(along, across)
        rings.append(point + radius * (np.cos(angles)[:, None] * across + np.sin(angles)[:, None] * other))
    ring, side = np.meshgrid(np.arange(len(line) - 1), np.arange(_SIDES), indexing="ij")
    a, b = ring * _SIDES + side, ring * _SIDES + (side + 1) % _SIDES
    faces = np.stack([a, b, b + _SIDES, a, b + _SIDES, a + _SIDES], axis=-1).reshape(-1, 3)
    return np.concatenate(rings), faces.astype(np.int32)
