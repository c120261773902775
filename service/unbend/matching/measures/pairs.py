"""The measures that need two whole signatures: distances between aligned canonical forms, and between Reeb graphs.

To add a measure, define a `PairMeasure` here and list it in `unbend.matching.measures.registry`. All these measures are
invariant to bending, rotation, reflection and scale. Alignment takes some milliseconds per pair, matching of Reeb
graphs about one.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from unbend.matching.measures.alignment import Residuals, align
from unbend.matching.measures.protocol import PairMeasure
from unbend.matching.measures.reeb import reeb_distance
from unbend.signature.signature import Signature


def rigid_distance(a: Signature, b: Signature) -> float:
    """Return the root mean square distance between two aligned canonical forms.

    The mean is over area and both directions, and a point's distance is that to the nearest point of the other form.
    The iterative closest point method searches for the minimum over rotations, reflections and translations. The unit
    is the forms' root mean square radius.
    """
    return min(root_mean_square(pose) for pose in align(a, b))


def root_mean_square(pose: Residuals) -> float:
    """Return the root mean square of the distances in both directions, weighted by area."""
    squares = [float((weights * d**2).sum()) for weights, d in zip(pose.weights, pose.distances, strict=True)]
    return float(np.sqrt(sum(squares) / 2))


def hausdorff_distance(a: Signature, b: Signature) -> float:
    """Return the modified Hausdorff distance between two canonical forms, aligned as for `rigid_distance`.

    For each direction, take the mean distance, weighted by area, from the points to the nearest point of the other
    form; the result is the larger mean (Dubuisson & Jain 1994). The Hausdorff distance uses the farthest point instead
    of the mean, which is often a single misplaced sample (benchmarks/retrieval/rerank.py compares both). In the same
    pose the result never exceeds the Hausdorff distance. The unit is the forms' root mean square radius.
    """
    return min(larger_mean(pose) for pose in align(a, b))


def larger_mean(pose: Residuals) -> float:
    """Return the larger of the mean distances, weighted by area, in both directions."""
    return max(float((weights * d).sum()) for weights, d in zip(pose.weights, pose.distances, strict=True))


def max_hausdorff_distance(a: Signature, b: Signature) -> float:
    """Return the Hausdorff distance between two canonical forms, aligned as for `rigid_distance`.

    This is the largest distance from any point of either form to the nearest point of the other, in units of the
    forms' root mean square radius. Section 2.3 of the paper proposes it for comparing forms.
    """
    return min(farthest(pose) for pose in align(a, b))


def farthest(pose: Residuals) -> float:
    """Return the largest distance in both directions."""
    return max(float(distances.max()) for distances in pose.distances)


RIGID: Final = PairMeasure("rigid", rigid_distance)
"""The distance after iterative closest points (Besl & McKay 1992), as Elad & Kimmel 2003 propose."""

HAUSDORFF: Final = PairMeasure("hausdorff", hausdorff_distance)
"""The modified Hausdorff distance (Dubuisson & Jain 1994) of aligned canonical forms."""

MAX_HAUSDORFF: Final = PairMeasure("max_hausdorff", max_hausdorff_distance)
"""The Hausdorff distance (Hausdorff 1914) of aligned canonical forms, as Elad & Kimmel 2003, section 2.3, propose."""

REEB: Final = PairMeasure("reeb", reeb_distance)
"""Reeb graphs of the mean geodesic distance, with parts in 1, 2, 4 and 8 intervals (Hilaga et al. 2001)."""
