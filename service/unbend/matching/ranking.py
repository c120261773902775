"""Ranking: a gallery's shapes by their distance from a query."""

from __future__ import annotations

from unbend.arrays import Floats, Indices
from unbend.matching.selection import smallest


def rank_shapes(distances: Floats, count: int | None = None) -> Indices:
    """Return the rows of the `count` smallest distances, nearest first; equal ones in the order of their rows.

    Rows at no finite distance are left out.
    """
    return smallest(distances, count)
