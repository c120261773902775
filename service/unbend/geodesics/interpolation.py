"""Interpolation of values at samples to all vertices."""

from __future__ import annotations

from typing import Final

import numpy as np

from unbend.arrays import Floats, Ints
from unbend.geodesics.distances import Update
from unbend.geodesics.fronts import spherical_radius
from unbend.geodesics.marching import UNREACHED, front_arrays, march
from unbend.geodesics.start import start_arrays, start_front
from unbend.geodesics.stencils import SLOTS, Stencils
from unbend.jit import kernel

_NEAR: Final = 1e-6  # least distance, as a share of `reach`, so that the weight at the sample itself is finite
_EVENTS: Final = 64  # events of a front's exact start, few because weights do not need exact distances


def interpolate(stencils: Stencils, samples: Ints, values: Floats, reach: float, update: Update) -> Floats:
    """Interpolate by inverse geodesic distance, among the samples within `reach` of each vertex.

    Franke & Little's weights (Franke 1982, "Scattered data interpolation: tests of some methods"): a sample at
    distance d has the weight ((reach - d) / (reach d))^2. The weights fall smoothly to zero at `reach`, so each
    sample's front can stop there. All fronts together take the time of about (reach / spacing)^2 complete fronts, for
    any number of samples.

    Parameters
    ----------
    stencils : Stencils
    samples : (k,) int32
        Vertices of the surface.
    values : (k, m) float64
    reach : float
        In the units of the surface; at least the largest distance from a vertex to its nearest sample.
    update : {"spherical", "planar"}

    Returns
    -------
    (n, m) float64
        Exactly `values` at the samples; zero at vertices without a sample within reach.
    """
    count = stencils.vertex_count
    total, weight = np.zeros((count, values.shape[1])), np.zeros(count)
    radius = reach / stencils.unit
    _spread_values(
        stencils.arrays, stencils.place[samples], values, radius,
        spherical_radius(stencils, spherical=update == "spherical"), np.full(count, np.float32(radius)), total, weight,
        np.empty(count, np.int32), SLOTS, start_arrays(count), front_arrays(count),
    )  # fmt: skip
    reached = weight > 0
    total[reached] /= weight[reached, None]
    result = total[stencils.place]
    result[samples] = values
    return result


@kernel
def _spread_values(stencils, sources, values, radius, disc, limit, total, weight, reached, width, start, front):
    slots, triangles = stencils
    seeds, distance = start[0], front[0]
    for row in range(len(sources)):
        seeded, exact = start_front(triangles, sources[row], _EVENTS, 0.0, radius, distance, start)
        size = march(slots, seeds[:seeded], exact, limit, disc, width, reached, front)
        for index in range(size):
            v = reached[index]
            share = max(distance[v] / radius, _NEAR)
            distance[v] = UNREACHED
            if share < 1.0:
                w = (1.0 / share - 1.0) ** 2
                weight[v] += w
                for axis in range(values.shape[1]):
                    total[v, axis] += w * values[row, axis]
