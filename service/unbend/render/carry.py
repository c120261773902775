"""Points on a surface, carried to where its canonical form has them."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from unbend.arrays import Floats, Indices, Ints

_CANDIDATES: Final = 12  # faces with the nearest centres
_AROUND: Final = 32  # largest number of faces that are taken around a vertex


def carry(vertices: Floats, faces: Ints, points: Floats, form: Floats) -> Floats:
    """Return where `points` (p, 3) on a surface are on its form, (p, 3).

    Each point belongs to the nearest of some faces: those with the nearest centres, and those around the two nearest
    vertices.

    Parameters
    ----------
    vertices : (n, 3) float64
        Finite where a face uses them.
    faces : (m, 3) int32
    points : (p, 3) float64
        Points on the faces.
    form : (n, 3) float64
        Another place, or any vector, for each vertex.
    """
    near = _faces_near(vertices, faces, points)
    corners = vertices[faces[near]]  # (p, k, 3, 3)
    shares = _shares(corners, points[:, None])
    distances = np.linalg.norm((shares[..., None] * corners).sum(axis=2) - points[:, None], axis=2)
    rows, best = np.arange(len(points)), distances.argmin(axis=1)
    return np.asarray((shares[rows, best][..., None] * form[faces[near[rows, best]]]).sum(axis=1))


def _faces_near(vertices: Floats, faces: Ints, points: Floats) -> Indices:
    """Return candidate faces for each point, (p, k): by the nearest centres, and around the two nearest vertices."""
    centres = vertices[faces].mean(axis=1)
    by_centre = cKDTree(centres).query(points, min(_CANDIDATES, len(centres)))[1].reshape(len(points), -1)
    used = np.unique(faces)
    nearest = used[cKDTree(vertices[used]).query(points, 2)[1]]
    order = np.argsort(faces, axis=None, kind="stable")
    starts = np.searchsorted(faces.ravel()[order], np.arange(len(vertices) + 1))
    around = [order[starts[vertex] : starts[vertex + 1]] // 3 for vertex in nearest.ravel()]
    most = min(max(len(part) for part in around), _AROUND)
    by_vertex = np.array([np.resize(part, most) for part in around]).reshape(len(points), -1)
    return np.concatenate([by_centre, by_vertex], axis=1)


def _shares(corners: Floats, points: Floats) -> Floats:
    """Return the barycentric coordinates of points projected onto triangles (..., 3, 3), moved inside, (..., 3)."""
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
