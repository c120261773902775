"""Hausdorff distances between canonical forms: the modified one, and the one that gave it its name."""

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
    radius. Never above the Hausdorff distance (`max_hausdorff`) in the same pose.
    """
    return min(larger_mean(found) for found in align(a, b))


def larger_mean(found: Residuals) -> float:
    """Return the larger of both directions' mean distances, by area."""
    return max(float((weights * d).sum()) for weights, d in zip(found.weights, found.distances, strict=True))


def max_hausdorff_distance(a: Signature, b: Signature) -> float:
    """Return the Hausdorff distance between two canonical forms laid on each other as for `rigid`.

    The farthest that any point of either form lies from the nearest of the other, in units of the forms' root mean
    square radius: what section 2.3 of the paper proposes for comparing forms.
    """
    return min(farthest(found) for found in align(a, b))


def farthest(found: Residuals) -> float:
    """Return the largest distance in either direction."""
    return max(float(distances.max()) for distances in found.distances)


HAUSDORFF: Final = PairMeasure(
    name="hausdorff",
    invariances=("bending", "rotation", "reflection", "scale"),
    reference="Dubuisson & Jain 1994: the modified Hausdorff distance, of canonical forms aligned as for rigid",
    cost="milliseconds: a search over poses",
    distance=hausdorff_distance,
)

MAX_HAUSDORFF: Final = PairMeasure(
    name="max_hausdorff",
    invariances=("bending", "rotation", "reflection", "scale"),
    reference="Hausdorff 1914, as Elad & Kimmel 2003, section 2.3, propose: of canonical forms aligned as for rigid",
    cost="milliseconds: a search over poses",
    distance=max_hausdorff_distance,
)
