"""Confidences of classes, and pieces of no known shape.

`benchmarks/partial/pieces.py` chooses the constants on half of the classes and reports on the other half.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from unbend.matching.partial.comparison import Comparison
from unbend.matching.partial.profiles import WIDEST, Profiles
from unbend.matching.partial.scanning import scan_parts

EXPONENT: Final = 28.6
"""The exponent with which the confidence of a class falls with its distance."""

SLACK: Final = 1.01
"""The largest ratio of a piece's distance from a shape to that of the same place of the shape from its class."""

_MEMBERS: Final = 16
"""Most members of a class that are considered."""


def unfamiliarity(
    query: Profiles, scanned: float, found: Comparison, shape: Profiles, members: Sequence[Profiles]
) -> float | None:
    """Return how much farther a query is from a shape than the same place of that shape is from its class.

    Some places, such as a trunk, look alike on all shapes, and others differ even between poses. So a piece is not
    compared with a fixed distance, but with the circles of the shape at the places where its own were found.

    Parameters
    ----------
    query : Profiles
    scanned : float
        Distance of the scan from the query to the shape.
    found : Comparison
        The query's comparison with the shape.
    shape : Profiles
        The nearest shape of the best class.
    members : sequence of Profiles
        Other members of the class.

    Returns
    -------
    float or None
        The ratio of both distances; None without members, or if the query contains the shape.
    """
    if not members or found.relation == "contains":
        return None
    moved = round(4 * np.log2(found.scale)) + query.first - shape.first
    place = replace(
        shape,
        chosen=found.places,
        rings=np.clip(query.rings + moved, 1, WIDEST).astype(np.int32),
        weights=np.where(query.rings + moved >= 1, query.weights, np.float32(0)),
        area=0.0,  # a part of every member
    )
    usual = scan_parts(place, [replace(each, is_open=False) for each in members[:_MEMBERS]], threads=1)
    return scanned / max(float(usual.mean()), np.finfo(float).tiny)
