"""Whether a query is of any class at all."""

from __future__ import annotations

from typing import Final

import numpy as np

from unbend.arrays import Floats
from unbend.matching.classification.query import Query
from unbend.matching.selection import smallest

_NEAR: Final = 256
"""Members of a class that are looked at, the nearest to the query: what is told of larger classes costs no more."""

_ASKED: Final = 32
"""Of them, those whose nearest others are looked for."""


def is_known(query: Query, code: int, slack: float) -> bool | None:
    """Say whether a query is near enough to a class to be of it.

    It is if it is no farther from the class' nearest member than members are from their nearest others: `slack`
    times their mean (Tax & Duin 2000 compare with a single neighbour's, Breunig et al. 2000 with several'). None
    where the class has a single member, which says nothing.

    Notes
    -----
    Taken literally, no farther than the farthest that a member is from the others, one query in n + 1 of a class
    of n members is refused (it is a conformal prediction, Vovk et al. 2005), and one outlying member widens the class
    for all. Near enough to any class, rather than the best, is nearly everything where one class is wide.
    `benchmarks/classification.py` measured how often a query of a class is refused and one of no class is let in,
    chose on half of the classes, by the least sum of both, and reports on the others.
    """
    near, own = spacing(query, code)
    return bool(near <= slack * own.mean()) if len(own) else None


def spacing(query: Query, code: int) -> tuple[float, Floats]:
    """Return the query's distance to a class' nearest member, and those of members to their nearest others.

    Members are the nearest to the query; none are returned where there are not two.
    """
    members = np.flatnonzero(query.gallery.codes == code)
    near = members[smallest(query.distances[members], _NEAR)]
    if len(near) < 2:
        return float(query.nearest[code]), np.empty(0)
    vectors = query.gallery.vectors[near]
    own = query.measure.between(vectors[:_ASKED], vectors)
    np.fill_diagonal(own, np.inf)
    return float(query.nearest[code]), own.min(axis=1)
