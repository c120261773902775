"""Moments of a shape's signatures in 1, 2, ... dimensions, to compare the choices of dimension."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from unbend.arrays import Floats
from unbend.descriptors.moments import moments
from unbend.descriptors.pose import principal_pose
from unbend.descriptors.quadrature import surface_quadrature
from unbend.embedding.embed import Method, embed
from unbend.embedding.weighting import weights_for
from unbend.geodesics.distances import geodesic_matrix
from unbend.mesh.surface import Surface
from unbend.signature.parameters import Parameters
from unbend.signature.pipeline import compute_signature

METHODS: Final[tuple[Method, ...]] = ("least_squares", "classical")

MOST: Final = 6


def moments_over_dimensions(
    surface: Surface, parameters: Parameters | None = None, *, most: int = MOST, threads: int | None = None
) -> dict[Method, Floats]:
    """Return the moments of a surface's signatures in 1 to `most` dimensions, by least squares and classical scaling.

    Parameters
    ----------
    surface : Surface
    parameters : Parameters, optional
        `dimensions` and `method` are ignored, and so are weights that a method does not support.
    most : int, default 6
    threads : int, optional
        All cores by default. The result does not depend on it.

    Returns
    -------
    dict of str to (most, 14) float64
        For each method, row d - 1 has the moments of the signature in d dimensions, of the surface scaled to area 1.

    Raises
    ------
    MeshGeometryError, ParameterError
        See `compute_signature`.
    """
    given = parameters or Parameters()
    plain = replace(given, dimensions=1, method="classical", weights="equal", starts=0)
    found = compute_signature(surface, plain, threads=threads)
    distances = geodesic_matrix(surface, found.samples, update=given.update, threads=threads) / np.sqrt(surface.area)
    weights = weights_for(given.weights, distances, found.weights)
    result: dict[Method, Floats] = {}
    for method in METHODS:
        least = method == "least_squares"
        used = weights if least or given.weights == "area" else None
        rows = []
        for dimensions in range(1, most + 1):
            points = embed(
                distances, dimensions, method=method, weights=used, starts=given.starts if least else 0,
                seed=given.seed, threads=threads,
            ).points  # fmt: skip
            posed = principal_pose(points, found.weights)
            rows.append(moments(*surface_quadrature(posed, found.faces, found.weights)))
        result[method] = np.stack(rows)
    return result
