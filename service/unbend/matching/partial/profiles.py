"""Local signatures in the form in which they are compared."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from unbend.arrays import Indices, Ints, Singles
from unbend.local.rings import unrepeated
from unbend.local.signatures import LocalSignatures

COMPARED: Final = 120
"""Circles of the smaller surface that are sought on the larger one: those farthest from the boundary."""

WIDEST: Final = 13
"""Rings that are compared. Their outer radii are about 0.07 to 0.6 of the square root of the larger surface's area."""

_FEWEST: Final = 3
"""Circles with fewer rings than this are chosen only if fewer circles than this have as many."""


@dataclass(frozen=True, eq=False)
class Profiles:
    """Rings without what they repeat, in units of their usual deviation, and what else a comparison needs."""

    values: Singles
    """(r, c): row k is that of the rings with the outer radius 2^((first + k) / 4)."""
    first: int
    chosen: Indices
    """Centres to seek on a larger surface, (m,), the farthest from the boundary first."""
    rings: Ints
    """Number of complete rings around each chosen centre, (m,) int32."""
    weights: Singles
    """Weight of each chosen circle, (m,): distance from the boundary over the square root of the area, at most 0.9."""
    area: float
    is_open: bool


def profiles_of(local: LocalSignatures) -> Profiles:
    """Return the profiles of local signatures.

    The first ring has none before it, so values begin with the second.
    """
    values = unrepeated(local.rings)
    radii = local.radii[2:]
    complete = np.minimum((local.reach[:, None] >= radii).sum(axis=1), WIDEST if not local.is_open else len(radii))
    order = np.argsort(-local.reach, kind="stable")
    good = order[complete[order] >= _FEWEST]
    chosen = (good if len(good) >= _FEWEST else order[:_FEWEST])[:COMPARED]
    return Profiles(
        values=np.ascontiguousarray(values.T, np.float32),
        first=local.first + 2,
        chosen=chosen.astype(np.int64),
        rings=np.maximum(complete[chosen], 1).astype(np.int32),
        weights=np.minimum(local.reach[chosen] / np.float32(np.sqrt(local.area)), np.float32(0.9)).astype(np.float32),
        area=local.area,
        is_open=local.is_open,
    )
