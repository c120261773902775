"""Known answers: exact polyhedral geodesics, and errors against them."""

from __future__ import annotations

import numpy as np
import pygeodesic.geodesic as exact_geodesics

from unbend import Surface


def exact_distances(surface: Surface, sources: np.ndarray) -> np.ndarray:
    """Exact geodesic distances (Mitchell, Mount, Papadimitriou) of a manifold surface, (k, n)."""
    algorithm = exact_geodesics.PyGeodesicAlgorithmExact(surface.vertices, surface.faces)
    return np.array([algorithm.geodesicDistances(np.array([source]))[0] for source in sources])


def mean_relative_error(distances: np.ndarray, exact: np.ndarray) -> float:
    """Mean of |d - exact| / exact over all pairs with a positive exact distance."""
    known = exact > 0
    return float((np.abs(distances - exact)[known] / exact[known]).mean())


def grid(columns: int, rows: int, shear: float = 0.0) -> Surface:
    """A flat unit-spaced grid of right triangles, sheared: x += shear y."""
    x, y = np.meshgrid(np.arange(columns + 1.0), np.arange(rows + 1.0))
    vertices = np.stack([x + shear * y, y, 0 * x], axis=-1).reshape(-1, 3)
    corner = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    right, up, both = corner + 1, corner + columns + 1, corner + columns + 2
    faces = np.concatenate([np.stack([corner, right, both], 1), np.stack([corner, both, up], 1)])
    return Surface(vertices, faces)
