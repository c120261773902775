"""Quadrature on triangulated surfaces: sums over points that integrate polynomials exactly."""

from __future__ import annotations

from typing import Final

import numpy as np

from unbend.arrays import Floats, Ints

_OUTER, _INNER = 0.445948490915965, 0.091576213509771
_RULE: Final[tuple[tuple[float, float], ...]] = ((_OUTER, 0.223381589678011), (_INNER, 0.109951743655322))
"""A rule of six points and degree 4 (Strang & Fix 1973; Dunavant 1985).

Each entry stands for three points: their barycentric coordinate at two of the corners, and their weight.
"""

_ROUNDING: Final = 1e-14
"""Three points count as a line if the squared sine of their angle is below this, the limit of double precision."""


def surface_quadrature(points: Floats, faces: Ints, weights: Floats) -> tuple[Floats, Floats]:
    """Return points and weights that integrate cubic polynomials exactly over triangles.

    The triangles of a signature do not have the area of the surface that they represent, so the area of each sample is
    spread over the triangles around it. The density is linear in each triangle, and the integral of each vertex' hat
    function is near its weight. If each weight is a third of the area of the triangles around its vertex, the density
    is 1.

    Parameters
    ----------
    points : (n, m) float64
    faces : (f, 3) int32
    weights : (n,) float64
        Area that each vertex represents.

    Returns
    -------
    points : (6 f + r, m) float64
        The last r points are the vertices of positive weight that have no triangle of positive area.
    weights : (6 f + r,) float64
    """
    corners = points[faces]
    areas = _areas(corners)
    around = np.bincount(faces.ravel(), np.repeat(areas / 3, 3), minlength=len(points))
    density = np.divide(weights, around, out=np.zeros(len(points)), where=around > 0)
    alone = (around == 0) & (weights > 0)
    shares = np.stack([_permuted(1 - 2 * share, share, corner) for share, _ in _RULE for corner in range(3)])  # (6, 3)
    rule = np.repeat([weight for _, weight in _RULE], 3)
    places = np.einsum("qc,fcm->qfm", shares, corners).reshape(-1, points.shape[1])
    masses = rule[:, None] * (shares @ density[faces].T) * areas
    return np.concatenate([places, points[alone]]), np.concatenate([masses.ravel(), weights[alone]])


def _permuted(own: float, other: float, corner: int) -> Floats:
    shares = np.full(3, other)
    shares[corner] = own
    return shares


def _areas(corners: Floats) -> Floats:
    """Return areas of triangles (f, 3, m) in m dimensions, 0 if the corners are on a line up to rounding."""
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    aa, bb, ab = ((x * y).sum(axis=1) for x, y in ((a, a), (b, b), (a, b)))
    squares = aa * bb - ab * ab
    return np.asarray(np.sqrt(np.where(squares > _ROUNDING * aa * bb, squares, 0.0)) / 2)
