"""Calibrated confidences and open-set rejection, and the constants of both.

`benchmarks/retrieval/classification.py` chooses the constants on half of the classes of three data sets, reports on the
other halves, and prints the table below. Run it after a measure has changed.
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
    """The constants of a measure. They apply to ratios of distances, so they do not depend on the unit."""

    exponents: Mapping[str, float]
    """For each classifier, the exponent with which confidence falls with the distance."""
    slack: float
    """The largest ratio of a query's distance from a class to the members' distances from each other."""


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

    Probabilities are proportional to dissimilarity ^ -`exponent`, so only ratios count and the unit does not matter.
    This inverse power was better calibrated than softmaxes of distances (`benchmarks/retrieval/classification.py`).
    Classes at dissimilarity 0 share the probability equally.
    """
    logarithms = -exponent * np.log(np.maximum(dissimilarities, np.finfo(float).tiny))
    shares = np.exp(logarithms - logarithms.max(axis=-1, keepdims=True))
    # Sorted, because the rounding of a sum depends on the order, and the order of classes must not show.
    total = np.sort(shares, axis=-1).sum(axis=-1, keepdims=True)
    return np.asarray(shares / total)


_NEAR_MEMBERS: Final = 256
"""The nearest members of a class that are considered, so that larger classes cost no more."""

_PROBES: Final = 32
"""The members among them whose own nearest neighbours are searched."""


def is_known(query: Query, code: int, slack: float) -> bool | None:
    """Return whether a query is near enough to a class to belong to it.

    It is if its distance from the nearest member is at most `slack` times the mean distance of members from their
    nearest neighbours in the class (Tax & Duin 2000 compare with a single neighbour's, Breunig et al. 2000 with
    several'). None if the class has a single member, which has no such neighbour.

    Notes ----- The stricter rule, no farther than the farthest that a member is from the others, rejects one query in n
    + 1 of a class of n members (it is a conformal prediction, Vovk et al. 2005), and a single outlier widens the class
    for all queries. Accepting a query that is near any class, instead of the best, accepts nearly everything if one
    class is wide. `benchmarks/retrieval/classification.py` measures how often a query of a class is rejected and one of
    no class is accepted. It chose the rule on half of the classes, by the least sum of both rates, and reports on the
    others.
    """
    near, own = spacing(query, code)
    return bool(near <= slack * own.mean()) if len(own) else None


def spacing(query: Query, code: int) -> tuple[float, Floats]:
    """Return the query's distance to the nearest member of a class, and the members' nearest neighbour distances.

    The members are those nearest to the query. The second array is empty if there are fewer than two.
    """
    members = np.flatnonzero(query.gallery.codes == code)
    near = members[smallest(query.distances[members], _NEAR_MEMBERS)]
    if len(near) < 2:
        return float(query.nearest[code]), np.empty(0)
    vectors = query.gallery.vectors[near]
    own = query.measure.between(vectors[:_PROBES], vectors)
    np.fill_diagonal(own, np.inf)
    return float(query.nearest[code]), own.min(axis=1)
