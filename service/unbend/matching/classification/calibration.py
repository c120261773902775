"""Calibrated confidences and open-set rejection, and the constants of both.

`benchmarks/retrieval/classification.py` chooses the constants on half of the classes of three data sets, reports on the
other halves, and prints the table `CALIBRATIONS`. Run it after a measure has changed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

import numpy as np

from unbend.arrays import Floats
from unbend.matching.classification.classifier import Query
from unbend.matching.selection import smallest


@dataclass(frozen=True)
class Calibration:
    """The constants of a measure. They apply to ratios of distances, so they do not depend on units."""

    exponents: Mapping[str, float]
    """The exponent with which confidence falls with distance, for each classifier."""
    slack: float
    """The largest ratio of a query's distance from a class to the distances between members (see `is_known`)."""


CALIBRATIONS: Final[Mapping[str, Calibration]] = MappingProxyType(
    {
        "spectrum": Calibration({"nearest": 8, "vote": 4.4, "mean": 7.4, "discriminants": 11}, 1.38),
        "combined": Calibration({"nearest": 8.9, "vote": 4.5, "mean": 7.2, "discriminants": 10}, 1.44),
        "moments": Calibration({"nearest": 5.5, "vote": 3.1, "mean": 4.7, "discriminants": 5.2}, 1.27),
        "distribution": Calibration({"nearest": 2.7, "vote": 2.1, "mean": 2.3, "discriminants": 6.2}, 1.48),
        "dimension": Calibration({"nearest": 1.5, "vote": 1.3, "mean": 1.7, "discriminants": 3.1}, 1.24),
        "surface_moments": Calibration({"nearest": 2.9, "vote": 2.1, "mean": 2.6, "discriminants": 3.8}, 0.77),
    }
)


def calibration_of(measure: str) -> Calibration:
    """Return a measure's constants, or those of `spectrum` if it has none."""
    return CALIBRATIONS.get(measure, CALIBRATIONS["spectrum"])


def confidences(dissimilarities: Floats, exponent: float) -> Floats:
    """Return the probability of each class, (..., n), from `dissimilarities` (..., n), finite and at least 0.

    Probabilities are proportional to dissimilarity ^ -`exponent`, so they depend only on ratios, not on units.
    This inverse power was better calibrated than softmaxes of distances (`benchmarks/retrieval/classification.py`).
    Classes at dissimilarity 0 share the probability equally.
    """
    logarithms = -exponent * np.log(np.maximum(dissimilarities, np.finfo(float).tiny))
    shares = np.exp(logarithms - logarithms.max(axis=-1, keepdims=True))
    # Sorted, because the rounding of a sum depends on the order, and results must not depend on the order of classes.
    total = np.sort(shares, axis=-1).sum(axis=-1, keepdims=True)
    return np.asarray(shares / total)


_NEAR_MEMBERS: Final = 256
"""Largest number of members of a class that are considered: the nearest ones. This bounds the time of large classes."""

_PROBES: Final = 32
"""Largest number of these members whose own nearest neighbours are searched."""


def is_known(query: Query, code: int, slack: float) -> bool | None:
    """Return whether a query is near enough to a class to belong to it.

    The query is near enough if its distance from the nearest member is at most `slack` times the mean distance of the
    members from their nearest neighbours in the class. (Tax & Duin 2000 use the distance of a single member, Breunig et
    al. 2000 those of several.) Return None if the class has a single member, which has no such neighbour.

    Notes
    -----
    Two other rules are worse. The first accepts a query if its distance from the nearest member is at most the largest
    distance of a member from its own nearest neighbour. For a class of n members this conformal prediction (Vovk et al.
    2005) rejects one in n + 1 of the class's queries, and a single outlier widens the class for all queries. The second
    accepts a query that is near any class, not only the best class. It accepts nearly everything if one class is wide.

    `benchmarks/retrieval/classification.py` measures how often a query of a class is rejected, and how often a query of
    no class is accepted. It chose the rule on half of the classes, by the least sum of both rates, and reports on the
    other half.
    """
    near, own = spacing(query, code)
    return bool(near <= slack * own.mean()) if len(own) else None


def spacing(query: Query, code: int) -> tuple[float, Floats]:
    """Return the query's distance to the nearest member of a class, and the members' nearest neighbour distances.

    Only the members nearest to the query are considered. The second array is empty if there are fewer than two.
    """
    members = np.flatnonzero(query.gallery.codes == code)
    near = members[smallest(query.distances[members], _NEAR_MEMBERS)]
    if len(near) < 2:
        return float(query.nearest[code]), np.empty(0)
    vectors = query.gallery.vectors[near]
    own = query.measure.between(vectors[:_PROBES], vectors)
    np.fill_diagonal(own, np.inf)
    return float(query.nearest[code]), own.min(axis=1)
