"""Points on a surface, carried to where its canonical form has them."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from unbend.arrays import Floats
from unbend.mesh.surface import Surface

_CANDIDATES: Final = 12  # faces with the nearest centres that may contain a point; their vertices' faces, too


def carry(surface: Surface, points: Floats, form: Floats) -> Floats:
    """Return where `points` (p, 3) on a surface are on its form, (p, 3).

    Each point is given to the face, of those around the nearest vertices and centres, that it is nearest to.

    Parameters
    ----------
    surface : Surface
    points : (p, 3) float64
        Points on its faces.
    form : (n, 3) float64
        Another place for each of its vertices.
    """
    faces = _faces_near(surface, points)
    corners = surface.vertices[surface.faces[faces]]  # (p, k, 3, 3)
    shares = _shares(corners, points[:, None])
    distances = np.linalg.norm((shares[..., None] * corners).sum(axis=2) - points[:, None], axis=2)
    best = distances.argmin(axis=1)
    rows = np.arange(len(points))
    return np.asarray((shares[rows, best][..., None] * form[surface.faces[faces[rows, best]]]).sum(axis=1))


def _faces_near(surface: Surface, points: Floats) -> np.ndarray:
    """Return candidate faces for each point, (p, k)."""
    centres = surface.vertices[surface.faces].mean(axis=1)
    count = min(_CANDIDATES, len(centres))
    near = cKDTree(centres).query(points, count)[1].reshape(len(points), count)
    used = surface.used_vertices
    nearest = used[cKDTree(surface.vertices[used]).query(points, min(2, len(used)))[1].reshape(len(points), -1)]
    order = np.argsort(surface.faces.ravel(), kind="stable")
    starts = np.searchsorted(surface.faces.ravel()[order], np.arange(len(surface.vertices) + 1))
    around = [order[starts[a] : starts[a + 1]] // 3 for a in nearest.ravel()]
    most = min(max(len(part) for part in around), 32)
    padded = np.array([np.resize(part[:most], most) for part in around]).reshape(len(points), -1)
    return np.concatenate([near, padded], axis=1)


def _shares(corners: Floats, points: Floats) -> Floats:
    """Return the barycentric coordinates of the points' feet on triangles (..., 3, 3), moved inside, (..., 3)."""
    first, second = corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :]
    apart = points - corners[..., 0, :]
    uu, uv, vv = (first * first).sum(-1), (first * second).sum(-1), (second * second).sum(-1)
    pu, pv = (apart * first).sum(-1), (apart * second).sum(-1)
    whole = uu * vv - uv * uv
    safe = np.where(whole > 0, whole, 1.0)
    b, c = (vv * pu - uv * pv) / safe, (uu * pv - uv * pu) / safe
    shares = np.clip(np.stack([1 - b - c, b, c], axis=-1), 0.0, None)
    shares = np.where((whole > 0)[..., None], shares, 1 / 3)
    return np.asarray(shares / shares.sum(axis=-1, keepdims=True))
