"""The geodesic Voronoi diagram: the nearest of several sources for each vertex, and its distance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from unbend.arrays import Floats, Ints
from unbend.brief import brief, counted
from unbend.geodesics.distances import Update, check_update, check_vertices
from unbend.geodesics.fronts import spherical_radius, spread
from unbend.geodesics.marching import UNREACHED, front_arrays
from unbend.geodesics.start import start_arrays
from unbend.geodesics.stencils import SLOTS, stencils_of
from unbend.jit import kernel
from unbend.mesh.smooth import boundary_edges
from unbend.mesh.surface import Surface


@dataclass(frozen=True, eq=False)
class VoronoiDiagram:
    """The geodesic Voronoi cells of sources, as sets of vertices."""

    distances: Floats  # (n,) to the nearest source, in units of the vertices; inf where none is reachable
    nearest: Ints  # (n,) int32: index of the nearest source; -1 where none is reachable
    areas: Floats  # (k,) areas of the cells; each corner of a triangle counts for a third of the triangle

    def __repr__(self) -> str:
        return brief(self, counted(len(self.areas), "cell"), counted(len(self.nearest), "vertex", "vertices"))


def geodesic_voronoi(surface: Surface, sources: ArrayLike, *, update: Update = "spherical") -> VoronoiDiagram:
    """Divide a surface among sources: each vertex belongs to the source that is nearest along the surface.

    Each source's front stops where an earlier source is nearer, so the total time is little more than that of a few
    fronts.

    Parameters
    ----------
    surface : Surface
    sources : int or (k,) array of int
        Vertex indices. A vertex that is equally near to several sources belongs to the first of them.
    update : {"spherical", "planar"}, default "spherical"
        See `geodesic_distances`.

    Raises
    ------
    ParameterError
        If a source is not a vertex, or `update` is not one of the values above.

    Examples
    --------
    >>> from unbend.mesh.shapes import sphere
    >>> diagram = geodesic_voronoi(sphere(), [0, 1])
    >>> sorted(set(diagram.nearest.tolist()))
    [0, 1]
    """
    check_update(update)
    stencils = stencils_of(surface)
    count = stencils.vertex_count
    chosen = check_vertices(surface, sources, "sources")
    distance, owner = np.full(count, UNREACHED), np.full(count, -1, np.int32)
    _spread_each(
        stencils.arrays, stencils.place[chosen], spherical_radius(stencils, spherical=update == "spherical"),
        distance, owner, np.empty(count, np.int32), SLOTS, start_arrays(count), front_arrays(count),
    )  # fmt: skip
    nearest = owner[stencils.place]
    areas = cell_areas(surface, nearest, len(chosen))
    return VoronoiDiagram(distance[stencils.place].astype(np.float64) * stencils.unit, nearest, areas)


def boundary_distances(surface: Surface) -> Floats:
    """Return the geodesic distance of each vertex from the boundary, (n,); infinite without a boundary."""
    rim = np.unique(boundary_edges(surface))
    return geodesic_voronoi(surface, rim).distances if len(rim) else np.full(len(surface.vertices), np.inf)


def cell_areas(surface: Surface, nearest: Ints, count: int) -> Floats:
    """Return the area of each of `count` cells, (count,), given the cell of each vertex, -1 for none."""
    reached = nearest >= 0
    return np.bincount(nearest[reached], surface.vertex_areas[reached], minlength=count).astype(np.float64)


@kernel
def _spread_each(stencils, sources, disc, distance, owner, reached, width, start, front):
    for label in range(len(sources)):
        spread(stencils, sources[label], label, disc, distance, owner, reached, width, start, front)
