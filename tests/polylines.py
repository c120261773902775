"""What holds of every polyline on a surface."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from unbend import Surface


def length(polyline: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(polyline, axis=0), axis=1).sum())


def distance_to_triangles(point: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Distances from a point (3,) to triangles (m, 3, 3), which may have no area."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    best = np.minimum(_to_segments(point, a, b), np.minimum(_to_segments(point, b, c), _to_segments(point, c, a)))
    normal = np.cross(b - a, c - a)
    size = np.linalg.norm(normal, axis=1)
    inside = size > 0
    for tail, head in ((a, b), (b, c), (c, a)):
        inside &= np.einsum("ij,ij->i", np.cross(head - tail, point - tail), normal) >= 0
    height = np.abs(np.einsum("ij,ij->i", point - a, normal)) / np.where(size > 0, size, 1)
    return np.where(inside, np.minimum(best, height), best)


def _to_segments(point: np.ndarray, tail: np.ndarray, head: np.ndarray) -> np.ndarray:
    along = head - tail
    squared = np.einsum("ij,ij->i", along, along)
    share = np.einsum("ij,ij->i", point - tail, along) / np.where(squared > 0, squared, 1)
    return np.linalg.norm(point - tail - np.clip(share, 0, 1)[:, None] * along, axis=1)


def distance_from_surface(surface: Surface, polyline: np.ndarray) -> float:
    """How far, at most, a segment's ends are from the triangle that is nearest to both; 0 if each lies in one."""
    corners = surface.vertices[surface.faces]
    low, high = corners.min(axis=1), corners.max(axis=1)
    slack = 1e-9 * np.ptp(surface.vertices[surface.used_vertices], axis=0).max()
    worst = 0.0
    for ends in pairwise(polyline):
        near = ((np.minimum(*ends) >= low - slack) & (np.maximum(*ends) <= high + slack)).all(axis=1)
        if not near.any():
            return float("inf")
        worst = max(worst, np.maximum(*(distance_to_triangles(end, corners[near]) for end in ends)).min())
    return float(worst)
