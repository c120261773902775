"""Named weights of pairs for the stress of eq. 2 (section 3.2: w_ij)."""

from __future__ import annotations

from typing import Final, Literal

import numpy as np

from unbend.arrays import Floats

Weighting = Literal["equal", "inverse", "inverse_squared", "area"]


_NEAREST: Final = 1e-3
_SMALLEST: Final = 1e-6  # area, of the mean: a sample on faces without area keeps its place


def weights_of(rule: Weighting, distances: Floats, areas: Floats) -> Floats | None:
    """Return what `embed` takes as `weights`.

    Parameters
    ----------
    rule : {"equal", "inverse", "inverse_squared", "area"}
        With 1 / d what is near counts for more; with 1 / d^2 errors count as shares of the distance (elastic scaling,
        McGee 1966). With "area" dense samples count for no more than sparse ones.
    distances : (n, n) float64
        What is nearer than a thousandth of the largest distance counts as that near: eq. 8 is solved in double
        precision.
    areas : (n,) float64
        That each sample stands for.

    Returns
    -------
    None, (n,) of points or (n, n) of pairs
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
