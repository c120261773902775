"""The signature surface's triangles."""

from __future__ import annotations

import numpy as np

from unbend.arrays import Ints


def voronoi_dual(faces: Ints, nearest: Ints) -> Ints:
    """Join samples whose geodesic Voronoi cells meet in a triangle of the surface.

    Parameters
    ----------
    faces : (m, 3) int32
        Of the surface.
    nearest : (n,) int32
        Sample nearest to each vertex; -1 where there is none.

    Returns
    -------
    (f, 3) int32
        Indices of samples, oriented as the surface is, each triangle once. With every vertex a sample these are
        the surface's own faces; samples too sparse for the surface's shape leave gaps.
    """
    corners = nearest[faces]
    a, b, c = corners.T
    dual = corners[(a != b) & (b != c) & (a != c) & (corners >= 0).all(axis=1)]
    _, first = np.unique(np.sort(dual, axis=1), axis=0, return_index=True)
    return np.asarray(dual[np.sort(first)])
