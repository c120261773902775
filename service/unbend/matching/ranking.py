"""Ranking: a gallery's shapes and classes by their distance from a query."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from unbend.arrays import Floats, Indices
from unbend.matching.measures import Measure


@dataclass(frozen=True)
class ClassMatch:
    """A class, as far from the query as its nearest member."""

    label: str
    distance: float
    confidence: float
    """This class' part of all classes' closeness (1 / distance), 0 to 1. It orders, it is not a probability."""


@dataclass(frozen=True)
class Gallery:
    """Shapes to compare with: one row, one label (None where unlabelled) each."""

    vectors: Floats  # (n, d)
    labels: Sequence[str | None]


def rank_shapes(distances: Floats, count: int | None = None) -> Indices:
    """Return the rows of the `count` smallest distances, nearest first; equal ones in the order of their rows."""
    return np.argsort(distances, kind="stable")[:count]


def rank_classes(distances: Floats, labels: Sequence[str | None]) -> list[ClassMatch]:
    """Return the classes, nearest first, each by its nearest member; unlabelled shapes take no part."""
    nearest: dict[str, float] = {}
    for label, distance in zip(labels, distances.tolist(), strict=True):
        if label is not None and distance < nearest.get(label, np.inf):
            nearest[label] = distance
    ordered = sorted(nearest.items(), key=lambda item: (item[1], item[0]))
    floor = max(np.finfo(float).tiny, 1e-9 * max(nearest.values(), default=1.0))
    closeness = [1.0 / max(distance, floor) for _, distance in ordered]
    total = sum(closeness)
    return [
        ClassMatch(label, distance, share / total) for (label, distance), share in zip(ordered, closeness, strict=True)
    ]


def is_known(gallery: Gallery, measure: Measure, best: ClassMatch | None) -> bool | None:
    """Say whether the nearest class is near enough: no farther than its members are from each other.

    That is the largest distance from a member of the class to the nearest other member. None where the class
    has a single member, which says nothing, or there is no class.
    """
    if best is None:
        return None
    members = gallery.vectors[[row for row, label in enumerate(gallery.labels) if label == best.label]]
    if len(members) < 2:
        return None
    return best.distance <= class_spread(members, measure)


def class_spread(members: Floats, measure: Measure) -> float:
    """Return the largest distance from a member (row of `members`) to its nearest other member."""
    return max(float(np.delete(measure.distances(member, members), row).min()) for row, member in enumerate(members))
