"""Hausdorff distance between canonical forms."""

from __future__ import annotations

from typing import Final

from unbend.matching.measures.alignment import Residuals, align
from unbend.matching.measures.protocol import PairMeasure
from unbend.signature.signature import Signature


def hausdorff_distance(a: Signature, b: Signature) -> float:
    """Return the modified Hausdorff distance between two canonical forms laid on each other as for `rigid`.

    Of both directions' mean distances, by area, from points to the nearest of the other form, the larger (Dubuisson &
    Jain 1994): where the Hausdorff distance takes the farthest point, it takes the mean of all, for the farthest is
    often one sample that lies elsewhere (benchmarks/rerank.py has both). In units of the forms' root mean square
    radius. Never above the Hausdorff distance in the same pose.
    """
    return min(larger_mean(found) for found in align(a, b))


def larger_mean(found: Residuals) -> float:
    """Return the larger of both directions' mean distances, by area."""
    return max(float((weights * d).sum()) for weights, d in zip(found.weights, found.distances, strict=True))


HAUSDORFF: Final = PairMeasure(
    name="hausdorff",
    invariances=("bending", "rotation", "reflection", "scale"),
    reference="Dubuisson & Jain 1994: the modified Hausdorff distance, of canonical forms aligned as for rigid",
    cost="milliseconds: a search over poses",
    distance=hausdorff_distance,
)
