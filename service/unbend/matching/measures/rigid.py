"""Rigid matching of canonical forms by iterative closest points."""

from __future__ import annotations

from typing import Final

import numpy as np

from unbend.matching.measures.alignment import Residuals, align
from unbend.matching.measures.protocol import PairMeasure
from unbend.signature.signature import Signature


def rigid_distance(a: Signature, b: Signature) -> float:
    """Return the root mean square distance between two canonical forms laid on each other.

    It is the mean by area of the squared distances from points to the nearest of the other form, in both directions,
    at the least over rotations, reflections and translations that was found: what the iterative closest point method
    lowers. In units of the forms' root mean square radius.
    """
    return min(root_mean_square(found) for found in align(a, b))


def root_mean_square(found: Residuals) -> float:
    """Return the root of the mean of both directions' mean squared distances, by area."""
    squares = [float((weights * d**2).sum()) for weights, d in zip(found.weights, found.distances, strict=True)]
    return float(np.sqrt(sum(squares) / 2))


RIGID: Final = PairMeasure(
    name="rigid",
    invariances=("bending", "rotation", "reflection", "scale"),
    reference="Besl & McKay 1992: iterative closest points, of canonical forms as Elad & Kimmel 2003 propose",
    cost="milliseconds: a search over poses",
    distance=rigid_distance,
)
