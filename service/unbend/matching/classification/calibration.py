"""The constants that make confidences probabilities, and that say how far is too far.

`benchmarks/classification.py` chooses them on half of the classes of three data sets, reports on the other halves, and
prints the table below: run it after a measure has changed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

import numpy as np

from unbend.arrays import Floats


@dataclass(frozen=True)
class Calibration:
    """What a measure's distances mean. All of it are ratios, so a change of unit changes nothing."""

    exponents: Mapping[str, float]
    """Of each classifier: how steeply its confidence falls with the distance."""
    slack: float
    """How many times as far from a class as its members are from each other a query may be."""


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
    """Return a measure's constants; those of the spectrum for one that has none."""
    return CALIBRATIONS.get(measure, CALIBRATIONS["spectrum"])


def confidences(remoteness: Floats, exponent: float) -> Floats:
    """Return the probability of each class, (..., n), from how far it is, `remoteness` (..., n): finite, at least 0.

    Proportional to remoteness ^ -`exponent`: what counts is how many times as far the others are. The inverse power
    was better calibrated than softmaxes of distances (`benchmarks/classification.py`) and knows no unit. Classes at
    no distance at all share alike.
    """
    logarithms = -exponent * np.log(np.maximum(remoteness, np.finfo(float).tiny))
    shares = np.exp(logarithms - logarithms.max(axis=-1, keepdims=True))
    # Sorted, because the rounding of a sum depends on the order, and the order of classes must not show.
    total = np.sort(shares, axis=-1).sum(axis=-1, keepdims=True)
    return np.asarray(shares / total)
