"""The frame of a surface: all channels of its vertices that matching compares, which bending hardly changes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from unbend.arrays import Floats, Indices, Ints, Singles
from unbend.correspondence.bivectors import BIVECTOR_FUNCTIONS, Orientation, orientation_of, vertex_bivectors
from unbend.correspondence.curvature import curvatures
from unbend.correspondence.functions import basis, scaling
from unbend.errors import MeshGeometryError
from unbend.geodesics.distances import distance_rows
from unbend.geodesics.sampling import sample_farthest
from unbend.geodesics.stencils import stencils_of
from unbend.geodesics.voronoi import cell_areas
from unbend.mesh.surface import Surface

FUNCTIONS: Final = 150
"""Most functions of the basis: half of the default number of samples, the rest of the spectrum is noise."""


@dataclass(frozen=True, eq=False)
class Frame:
    """Channels of all n vertices of a surface, from geodesic distances to S samples. Lengths are over sqrt(area)."""

    surface: Surface
    samples: Indices  # (S,) vertices, by farthest point sampling
    nearest: Ints  # (n,) the nearest sample of each vertex
    weights: Floats  # (S,) share of the area nearest to each sample
    rows: Singles  # (S, n) geodesic distances
    radius: float  # largest distance from a vertex to its nearest sample
    functions: Singles  # (n, k) the basis, orthonormal under `masses` at the samples
    masses: Floats  # (S,)
    points: Floats  # (n, 4) coordinates of classical scaling
    bivectors: Singles  # (n, b) of the first functions, outward
    orientation: Orientation
    curvatures: Singles  # (n, 4)

    @property
    def unit(self) -> float:
        """Length of the surface that is 1 here: the square root of its area."""
        return float(np.sqrt(self.surface.area))

    def at_samples(self) -> Frame:
        """Return the frame whose only vertices are the samples, to compare many maps quickly."""
        chosen, every = self.samples, np.arange(len(self.samples))
        return replace(
            self, samples=every, nearest=every, rows=self.rows[:, chosen], functions=self.functions[chosen],
            points=self.points[chosen], bivectors=self.bivectors[chosen], curvatures=self.curvatures[chosen],
        )  # fmt: skip


def frame_of(surface: Surface, count: int, threads: int | None) -> Frame:
    """Sample a connected surface, march from each sample to every vertex, and derive all channels.

    Raises
    ------
    MeshGeometryError
        If the surface has no area, or its faces are not connected.
    """
    if not surface.area > 0:
        raise MeshGeometryError("every face has zero area")
    stencils = stencils_of(surface)
    sampling = sample_farthest(surface, stencils, min(count, len(surface.vertices)))
    unit = np.sqrt(surface.area)
    rows = (distance_rows(stencils, sampling.samples.astype(np.int32), None, "spherical", threads) / unit).astype(
        np.float32
    )
    if not np.isfinite(rows).all():
        raise MeshGeometryError("the faces are not connected: keep one component")
    areas = cell_areas(surface, sampling.nearest, len(sampling.samples))
    weights = np.maximum(areas / areas.sum(), np.finfo(np.float64).tiny)
    functions, masses = basis(rows, sampling.samples, weights, FUNCTIONS)
    orientation = orientation_of(surface)
    return Frame(
        surface=surface,
        samples=sampling.samples,
        nearest=sampling.nearest,
        weights=weights,
        rows=rows,
        radius=sampling.radius / unit,
        functions=functions.astype(np.float32),
        masses=masses,
        points=scaling(rows, sampling.samples, weights),
        bivectors=vertex_bivectors(surface, functions[:, BIVECTOR_FUNCTIONS], orientation.sign).astype(np.float32),
        orientation=orientation,
        curvatures=curvatures(surface, orientation.sign).astype(np.float32),
    )
