"""The effective dimension m of a shape, which is itself a bending invariant (section 3: "an invariant measure")."""

from __future__ import annotations

from typing import Final

import numpy as np

from unbend.arrays import Floats
from unbend.embedding.dimension import MAX_DIMENSIONS, representation_errors
from unbend.tolerances import REPRESENTATION_ERROR

ERRORS: Final = 6


def dimension_vector(distances: Floats) -> Floats:
    """Return the effective dimension and the representation errors (eq. 6) in 1 to 6 dimensions.

    Parameters
    ----------
    distances : (k, k) float64
        Geodesic distances in any unit.

    Returns
    -------
    (7,) float64
        First the effective dimension: the least number of dimensions, up to 12, with an error of at most 5 %. Then the
        errors.
    """
    errors = representation_errors(distances)
    vector = np.zeros(1 + ERRORS)
    vector[0] = min(MAX_DIMENSIONS, int(np.flatnonzero(errors <= REPRESENTATION_ERROR)[0]) + 1)
    vector[1 : 1 + min(ERRORS, len(errors))] = errors[:ERRORS]
    return vector
