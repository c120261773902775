"""Views of a piece and of its whole from their samples, in the same units."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from unbend.arrays import Floats, Indices, Ints
from unbend.correspondence.bivectors import Orientation, orientation_of
from unbend.correspondence.curvature import curvatures_of_part
from unbend.correspondence.parts.bounds import crossings, least_distances
from unbend.correspondence.parts.directions import Directions, directions_of
from unbend.errors import MeshGeometryError
from unbend.geodesics.distances import distance_rows
from unbend.geodesics.sampling import sample_farthest
from unbend.geodesics.stencils import stencils_of
from unbend.geodesics.voronoi import boundary_distances, cell_areas
from unbend.local.growth import add_growth
from unbend.local.rings import unrepeated
from unbend.mesh.surface import Surface

RADII: Final = 0.07 * 2.0 ** (np.arange(14) / 4)
"""Radii of the circles whose areas are compared."""

OUTER: Final = RADII[2:]
"""Radius of the largest circle that each ring depends on."""


@dataclass(frozen=True, eq=False)
class View:
    """A surface, a piece or a whole, of n vertices. Lengths are over the square root of the area of the whole."""

    surface: Surface
    unit: float
    orientation: Orientation
    samples: Indices  # (S,) vertices, by farthest point sampling
    nearest: Ints  # (n,) the nearest sample of each vertex
    weights: Floats  # (S,) share of the area nearest to each sample
    radius: float  # largest distance from a vertex to its nearest sample
    rows: Floats  # (S, n) distances
    least: Floats  # (S, n) least distances in the whole
    reach: Floats  # (n,) distance from the boundary
    rings: Floats  # (S, r) what rings around each sample do not repeat of the ring before, in usual deviations
    curvatures: Floats  # (n, 4)
    courses: Directions  # (n, S) direction away from each sample

    def scaled(self, factor: float) -> View:
        """Return the view of the same surface enlarged; the curvatures are left as they are."""
        rows, unit = self.rows * factor, self.unit / factor
        return replace(
            self, unit=unit, radius=self.radius * factor, rows=rows, least=self.least * factor,
            reach=self.reach * factor, rings=_rings(self.surface, rows, unit),
        )  # fmt: skip


def views_of(part: Surface, whole: Surface, samples: int, threads: int | None) -> tuple[View, View]:
    """Return the views of a piece and of its whole.

    Raises
    ------
    MeshGeometryError
        If a surface has no area, or its faces are not connected.
    """
    if not (part.area > 0 and whole.area > 0):
        raise MeshGeometryError("every face has zero area")
    one, other = orientation_of(part), orientation_of(whole)
    ours, theirs = curvatures_of_part(part, whole, one.sign, other.sign)
    unit = float(np.sqrt(whole.area))
    return _view(part, unit, samples, one, ours, threads), _view(whole, unit, samples, other, theirs, threads)


def _view(
    surface: Surface, unit: float, count: int, orientation: Orientation, curved: Floats, threads: int | None
) -> View:
    stencils = stencils_of(surface)
    sampling = sample_farthest(surface, stencils, min(count, len(surface.vertices)))
    rows = distance_rows(stencils, sampling.samples.astype(np.int32), None, "spherical", threads) / unit
    if not np.isfinite(rows).all():
        raise MeshGeometryError("the faces are not connected: keep one component")
    areas = cell_areas(surface, sampling.nearest, len(rows))
    least, reach = _within_boundary(surface, rows, unit, threads)
    return View(
        surface=surface,
        unit=unit,
        orientation=orientation,
        samples=sampling.samples,
        nearest=sampling.nearest,
        weights=np.maximum(areas / areas.sum(), np.finfo(np.float64).tiny),
        radius=sampling.radius / unit,
        rows=rows,
        least=least,
        reach=reach,
        rings=_rings(surface, rows, unit),
        curvatures=curved,
        courses=directions_of(surface, orientation.sign, rows),
    )


def _within_boundary(surface: Surface, rows: Floats, unit: float, threads: int | None) -> tuple[Floats, Floats]:
    """Return the least distances in the whole, (S, n), and the distance of each vertex from the boundary, (n,)."""
    reach = boundary_distances(surface) / unit
    chosen = crossings(surface)
    if not len(chosen):
        return rows, reach
    away = distance_rows(stencils_of(surface), chosen.astype(np.int32), None, "spherical", threads) / unit
    places = surface.vertices[chosen] / unit
    straight = np.linalg.norm(places[:, None] - places, axis=2)
    least = least_distances(rows[:, chosen], np.ascontiguousarray(away.T), straight, rows)
    return least, reach


def _rings(surface: Surface, rows: Floats, unit: float) -> Floats:
    """Return what each ring between two circles does not repeat of the ring before it, in usual deviations, (S, r)."""
    growth = np.zeros((len(rows), len(RADII)))
    add_growth(rows, surface.faces, surface.face_areas / unit**2, RADII, growth)
    growth /= RADII**2
    rings = growth[:, 1:] - (RADII[0] / RADII[2]) * growth[:, :-1]
    return unrepeated(rings)
