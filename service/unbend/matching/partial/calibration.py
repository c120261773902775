"""Confidences of classes, and pieces of no known shape.

`benchmarks/partial/pieces.py` chooses the constants on half of the classes and reports on the other half.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from unbend.local.signatures import OCTAVE, LocalSignatures
from unbend.matching.partial.comparison import Comparison, compare_profiled
from unbend.matching.partial.profiles import WIDEST, profiles_of

EXPONENT: Final = 61.1
"""The exponent with which the confidence of a class falls with its distance."""

SLACK: Final = 0.93
"""The largest unfamiliarity of a piece of a known class."""

_USUAL: Final = 0.77
"""The assumed ratio of the distance of the best class to that of the next one, if there is no other class."""

MEMBERS: Final = 16
"""Most members of a class that are considered."""


def unfamiliarity(
    query: LocalSignatures,
    found: Comparison,
    shape: LocalSignatures,
    members: Sequence[LocalSignatures],
    next_class: float | None,
) -> float | None:
    """Return how much farther a query is from a shape than the same place of that shape is from its class.

    Some places, such as a trunk, look alike on all shapes, and others differ even between poses. So a piece is not
    compared with a fixed distance, but with the circles of the shape at the places where its own were found. A piece
    of no known class is also nearly equally far from several classes.

    Parameters
    ----------
    query : LocalSignatures
    found : Comparison
        The query's comparison with the shape.
    shape : LocalSignatures
        The nearest shape of the best class.
    members : sequence of LocalSignatures
        Other members of the class.
    next_class : float, optional
        Distance of the nearest shape of another class.

    Returns
    -------
    float or None
        The ratio of both distances, times the root of the ratio of the distance to that of the next class; None
        without members, or if the query contains the shape.
    """
    if not members or found.relation == "contains":
        return None
    profiles, whole = profiles_of(query), profiles_of(shape)
    moved = round(OCTAVE * np.log2(found.scale)) + profiles.first - whole.first
    rings = profiles.rings + moved
    place = replace(
        whole,
        chosen=found.places,
        rings=np.clip(rings, 1, WIDEST).astype(np.int32),
        weights=np.where(rings >= 1, profiles.weights, np.float32(0)),
        area=query.area * found.scale**2,
    )
    usual = [
        compare_profiled(shape, place, member, replace(profiles_of(member), is_open=False), 0).distance
        for member in members[:MEMBERS]
    ]
    ratio = found.distance / max(float(np.mean(usual)), np.finfo(float).tiny)
    return ratio * float(np.sqrt(_USUAL if next_class is None else found.distance / next_class))
