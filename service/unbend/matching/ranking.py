"""Ranking: a gallery's shapes and classes by their distance from a query."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from unbend.arrays import Floats, Indices, Singles
from unbend.matching.gallery import Gallery
from unbend.matching.measures import VectorMeasure


@dataclass(frozen=True)
class ClassMatch:
    """A class, as far from the query as its nearest member."""

    label: str
    distance: float
    confidence: float
    """This class' part of all classes' closeness (1 / distance), 0 to 1. It orders, it is not a probability."""


def rank_shapes(distances: Floats, count: int | None = None) -> Indices:
    """Return the rows of the `count` smallest distances, nearest first; equal ones in the order of their rows."""
    return np.argsort(distances, kind="stable")[:count]


def rank_classes(distances: Floats, gallery: Gallery) -> list[ClassMatch]:
    """Return the classes, nearest first, each by its nearest member; unlabelled shapes take no part."""
    nearest = np.full(len(gallery.labels) + 1, np.inf)
    np.minimum.at(nearest, gallery.codes, distances)  # what is unlabelled goes to the last place
    found = [(float(nearest[code]), label) for code, label in enumerate(gallery.labels) if np.isfinite(nearest[code])]
    ordered = sorted(found)
    floor = max(np.finfo(float).tiny, 1e-9 * max((distance for distance, _ in ordered), default=1.0))
    closeness = [1.0 / max(distance, floor) for distance, _ in ordered]
    total = sum(closeness)
    return [
        ClassMatch(label, distance, share / total) for (distance, label), share in zip(ordered, closeness, strict=True)
    ]


def is_known(gallery: Gallery, measure: VectorMeasure, best: ClassMatch | None) -> bool | None:
    """Say whether the nearest class is near enough: no farther than its members are from each other.

    That is the largest distance from a member of the class to the nearest other member. None where the class
    has a single member, which says nothing, or there is no class.
    """
    if best is None:
        return None
    members = gallery.vectors[gallery.codes == gallery.labels.index(best.label)]
    if len(members) < 2:
        return None
    return best.distance <= class_spread(members, measure)


def class_spread(members: Singles, measure: VectorMeasure) -> float:
    """Return the largest distance from a member (row of `members`) to its nearest other member."""
    return max(float(np.delete(measure.distances(member, members), row).min()) for row, member in enumerate(members))
