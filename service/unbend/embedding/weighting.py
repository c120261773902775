"""Named weights of pairs for the stress of eq. 2 (section 3.2: w_ij)."""

from __future__ import annotations

from typing import Final, Literal

import numpy as np

from unbend.arrays import Floats

Weighting = Literal["equal", "inverse", "inverse_squared", "area"]

_NEAREST: Final = 1e-3  # least distance, as a share of the largest
_SMALLEST: Final = 1e-6  # least area, as a share of the mean, so that a sample on faces of zero area still counts


def weights_for(rule: Weighting, distances: Floats, areas: Floats) -> Floats | None:
    """Return the argument `weights` of `embed` for a named rule.

    Parameters
    ----------
    rule : {"equal", "inverse", "inverse_squared", "area"}
        "inverse" is 1 / d: short distances count more. "inverse_squared" is 1 / d^2: errors relative to the distance
        count equally (elastic scaling, McGee 1966). "area" makes densely sampled regions count no more than others.
    distances : (n, n) float64
        Distances below a thousandth of the largest distance are raised to that thousandth, because eq. 8 is solved in
        double precision.
    areas : (n,) float64
        Area that each sample represents.

    Returns
    -------
    None, (n,) or (n, n) float64
        No weights, weights of points, or weights of pairs.
    """
    if rule == "equal":
        return None
    if rule == "area":
        floored: Floats = np.maximum(areas, _SMALLEST * areas.mean())
        return floored
    if not distances.max() > 0:
        return None
    inverse = 1.0 / np.maximum(distances / distances.max(), _NEAREST)
    weights: Floats = inverse if rule == "inverse" else inverse**2
    return weights
