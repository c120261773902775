"""Fronts from a source: the exact start, then marching, over the whole surface or over one Voronoi cell."""

from __future__ import annotations

import numpy as np

from unbend.arrays import Floats, Ints
from unbend.geodesics.marching import UNREACHED, front_arrays, march
from unbend.geodesics.start import start_arrays, start_front
from unbend.geodesics.stencils import SLOTS, Stencils
from unbend.jit import kernel
from unbend.tolerances import PLANAR_START, PLANAR_START_EDGES, START_EVENTS, START_RADIUS


def march_each(stencils: Stencils, sources: Ints, columns: Ints, rows: Floats, *, spherical: bool) -> None:
    """March from each of `sources` in turn and write the distances at `columns` to `rows` (k, len(columns)).

    Sources and columns are vertices in the numbering of `stencils`; distances are in the units of the surface.
    """
    count = stencils.vertex_count
    _march_each(
        stencils.arrays, stencils.unit, sources, columns, rows, spherical_radius(stencils, spherical=spherical),
        np.full(count, UNREACHED), np.empty(count, np.int32), SLOTS, start_arrays(count), front_arrays(count),
    )  # fmt: skip


def spherical_radius(stencils: Stencils, *, spherical: bool) -> float:
    """Return the radius, in median edges, within which updates are spherical."""
    return np.inf if spherical else max(PLANAR_START_EDGES, PLANAR_START * stencils.face_count**0.5)


@kernel
def _march_each(stencils, unit, sources, columns, rows, disc, limit, reached, width, start, front):
    slots, triangles = stencils
    seeds, values = start[0], front[0]
    for row in range(len(sources)):
        values[:] = UNREACHED
        seeded, exact = start_front(triangles, sources[row], START_EVENTS, START_RADIUS, np.inf, values, start)
        march(slots, seeds[:seeded], exact, limit, disc, width, reached, front)
        for column in range(len(columns)):
            rows[row, column] = values[columns[column]] * unit


@kernel
def raise_to_straight(points, sources, columns, rows):
    """Raise `rows` (k, len(columns)) to at least the straight-line distances; on needles marching can give less."""
    for row in range(len(sources)):
        source = sources[row]
        for column in range(len(columns)):
            v = columns[column]
            dx = points[v, 0] - points[source, 0]
            dy = points[v, 1] - points[source, 1]
            dz = points[v, 2] - points[source, 2]
            straight = np.sqrt(dx * dx + dy * dy + dz * dz)
            if straight > rows[row, column]:  # noqa: PLR1730 (not `max`: unused vertices may have NaN coordinates)
                rows[row, column] = straight


@kernel
def spread(stencils, source, label, disc, distance, owner, reached, width, start, front):
    """March from `source` over the vertices that are nearer to it than to the earlier sources.

    At these vertices, lower `distance` and set `owner` to `label`. Each front stops at the border of its geodesic
    Voronoi cell, so even many sources take little more time than a few complete fronts. A front starts like a complete
    one, so both find the same distances.
    """
    slots, triangles = stencils
    seeds, values = start[0], front[0]
    seeded, exact = start_front(triangles, source, START_EVENTS, START_RADIUS, distance[source], values, start)
    size = march(slots, seeds[:seeded], exact, distance, disc, width, reached, front)
    for index in range(size):
        v = reached[index]
        if values[v] < distance[v]:
            distance[v] = values[v]
            owner[v] = label
        values[v] = UNREACHED
