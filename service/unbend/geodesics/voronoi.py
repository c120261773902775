"""Distances from several sources at once, and which is nearest: the geodesic Voronoi diagram."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from unbend.arrays import Floats, Ints
from unbend.geodesics.distances import Update, check_update, check_vertices
from unbend.geodesics.fronts import spherical_radius, spread
from unbend.geodesics.marching import UNREACHED, front_arrays
from unbend.geodesics.start import start_arrays
from unbend.geodesics.stencils import SLOTS, stencils_of
from unbend.jit import kernel
from unbend.mesh.surface import Surface


@dataclass(frozen=True, eq=False)
class VoronoiDiagram:
    """The cells of a surface's vertices about sources."""

    distances: Floats  # (n,) to the nearest source, in units of the vertices; inf where none can be reached
    nearest: Ints  # (n,) int32: place of the nearest one among the sources; -1 where none can be reached
    areas: Floats  # (k,) of the cells, a third of each triangle going to each of its corners


def geodesic_voronoi(surface: Surface, sources: ArrayLike, *, update: Update = "spherical") -> VoronoiDiagram:
    """Divide a surface among sources: each vertex goes to the one that is nearest along the surface.

    Each source's front stops where an earlier one's was nearer, so the whole costs little more than a few fronts.

    Parameters
    ----------
    surface : Surface
    sources : int or (k,) array of int
        Vertex indices. Of equally near sources, or of one given twice, the first has the vertex.
    update : {"spherical", "planar"}, default "spherical"
        As in `geodesic_distances`.

    Raises
    ------
    ParameterError
        If a source is not a vertex, or `update` is not one of the values above.
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
    held = nearest >= 0
    areas = np.bincount(nearest[held], surface.vertex_areas[held], minlength=len(chosen)).astype(np.float64)
    return VoronoiDiagram(distance[stencils.place].astype(np.float64) * stencils.unit, nearest, areas)


@kernel
def _spread_each(stencils, sources, disc, distance, owner, reached, width, start, front):
    for label in range(len(sources)):
        spread(stencils, sources[label], label, disc, distance, owner, reached, width, start, front)
