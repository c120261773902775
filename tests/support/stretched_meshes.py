"""Surfaces of stretched triangles: height maps, and models like those of CAD programs."""

from __future__ import annotations

from functools import cache

import numpy as np

from unbend import Surface


def height_map(slope: float, size: int = 25, seed: int = 0) -> Surface:
    """Return a smooth height map of `size` by `size` vertices over the unit square; `slope` is the largest in x."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.linspace(0, 1, size), np.linspace(0, 1, size))
    z = np.zeros_like(x)
    for k in range(1, 4):
        for m in range(1, 4):
            wave = np.sin(np.pi * k * x + rng.uniform(0, 6)) * np.sin(np.pi * m * y + rng.uniform(0, 6))
            z += rng.normal() / (k + m) * wave
    z *= slope / (np.abs(np.diff(z, axis=1)).max() * (size - 1))
    corner = (np.arange(size - 1)[:, None] * size + np.arange(size - 1)).ravel()
    right, up, both = corner + 1, corner + size, corner + size + 1
    faces = np.concatenate([np.stack([corner, right, both], 1), np.stack([corner, both, up], 1)])
    return Surface(np.stack([x, y, z], axis=-1).reshape(-1, 3), faces)


@cache
def cad_models() -> dict[str, Surface]:
    """Return eleven closed models of fans, needles and strips; their vertices are at corners, rims and centres only."""
    return {
        "box": _prism(np.array([[0, 0], [2, 0], [2, 3], [0, 3.0]]), 4),
        "plate": _prism(np.array([[0, 0], [10, 0], [10, 7], [0, 7.0]]), 0.2),
        "rod": _prism(_circle(24, 0.1), 5),
        "disc": _prism(_circle(96, 5), 0.3),
        "ring": _ring(48, 2, 3, 1),
        "washer": _ring(64, 0.5, 3, 0.1),
        "tube": _ring(100, 0.45, 0.5, 10),
        "cone": _revolved([(0, 0), (1, 0), (0.02, 4), (0, 4)], 64),
        "spindle": _revolved([(0, 0), (0.5, 0), (0.5, 3), (2, 3.1), (2, 3.5), (0.3, 3.6), (0.3, 8), (0, 8)], 40),
        "bottle": _revolved([(0, 0), (1, 0), (1, 3), (0.3, 4), (0.3, 5), (0, 5)], 72),
        "bolt": _revolved([(0, 0), (1, 0), (1, 0.6), (0.5, 0.6), (0.5, 4), (0, 4)], 6),
    }


def _circle(count: int, radius: float) -> np.ndarray:
    turn = 2 * np.pi * np.arange(count) / count
    return np.stack([radius * np.cos(turn), radius * np.sin(turn)], axis=1)


def _prism(base: np.ndarray, height: float) -> Surface:
    """Return a prism over a convex polygon; each end is a fan around a corner."""
    count = len(base)
    vertices = np.concatenate([np.c_[base, np.zeros(count)], np.c_[base, np.full(count, height)]])
    faces = [[0, i + 1, i] for i in range(1, count - 1)]
    faces += [[count, count + i, count + i + 1] for i in range(1, count - 1)]
    for i in range(count):
        j = (i + 1) % count
        faces += [[i, j, count + j], [i, count + j, count + i]]
    return Surface(vertices, np.array(faces))


def _ring(count: int, inner: float, outer: float, height: float) -> Surface:
    circles = [np.c_[_circle(count, radius), np.full(count, z)] for z in (0.0, height) for radius in (outer, inner)]
    faces = []
    for i in range(count):
        j = (i + 1) % count
        low, high, low_in, high_in = (np.array([i, j]) + k * count for k in (0, 2, 1, 3))
        faces += [[low[0], low[1], high[1]], [low[0], high[1], high[0]]]
        faces += [[low_in[1], low_in[0], high_in[0]], [low_in[1], high_in[0], high_in[1]]]
        faces += [[high[0], high[1], high_in[1]], [high[0], high_in[1], high_in[0]]]
        faces += [[low[1], low[0], low_in[0]], [low[1], low_in[0], low_in[1]]]
    return Surface(np.concatenate(circles), np.array(faces))


def _revolved(profile: list[tuple[float, float]], count: int) -> Surface:
    """Return the surface of revolution of a profile of (radius, height), whose ends are on the axis."""
    radius, height = np.array(profile, float).T
    rims = [np.c_[_circle(count, r), np.full(count, z)] for r, z in zip(radius[1:-1], height[1:-1], strict=True)]
    last = 1 + count * len(rims)
    faces = []
    for i in range(count):
        j = (i + 1) % count
        faces.append([0, 1 + j, 1 + i])
        for rim in range(len(rims) - 1):
            low, high = 1 + rim * count, 1 + (rim + 1) * count
            faces += [[low + i, low + j, high + j], [low + i, high + j, high + i]]
        faces.append([last - count + i, last - count + j, last])
    return Surface(np.concatenate([[[0, 0, height[0]]], *rims, [[0, 0, height[-1]]]]), np.array(faces))
