"""The class map: shapes as points whose distances are those of their descriptors (section 2.3 and Fig. 8: D_M)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from unbend.arrays import Floats, Indices, Singles, frozen
from unbend.descriptors.pose import principal_pose
from unbend.embedding.embed import embed
from unbend.embedding.extension import extend
from unbend.embedding.stress import stress
from unbend.matching.measures import VectorMeasure

LANDMARKS: Final = 2000
"""Shapes that are embedded by all their distances; a map of more places the others by distances to some of these."""

_GUIDES: Final = 200
"""Landmarks whose distances place a further shape."""


@dataclass(frozen=True, eq=False)
class ClassMap:
    """A place for each shape; defined up to rotation and reflection, and turned to its principal axes."""

    points: Floats
    """(n, m)."""
    stress: float
    """Eq. 2 of the shapes that were embedded by all their distances: 0 where the map is exact."""
    landmarks: Indices
    """Which those are, (l,); all where there are no more than `LANDMARKS`."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", frozen(self.points, np.float64))
        object.__setattr__(self, "landmarks", frozen(self.landmarks, np.int64))


def class_map(vectors: Singles, measure: VectorMeasure, dimensions: int = 2, *, threads: int | None = None) -> ClassMap:
    """Place shapes so that straight-line distances are near those under `measure`.

    Parameters
    ----------
    vectors : (n, d) float32
        One a shape, finite.
    measure : VectorMeasure
    dimensions : int, default 2
    threads : int, optional
        All cores by default. The result does not depend on it.

    Returns
    -------
    ClassMap
        The same for the same shapes, on every run.

    Raises
    ------
    ParameterError
        If `dimensions` or `threads` is below 1.
    """
    landmarks = _landmarks(vectors, measure)
    distances = measure.matrix(vectors[landmarks])
    if not distances.any():  # no shape, one, or copies of one: embedding has no scale to work in
        return ClassMap(np.zeros((len(vectors), dimensions)), 0.0, landmarks)
    # Distances may be 1e-4 or 1e4, by measure; what follows takes them near 1.
    unit = float(distances.max())
    found = embed(distances / unit, dimensions, threads=threads).points
    points = found
    if len(landmarks) < len(vectors):
        squared = measure.between(vectors[landmarks[:_GUIDES]], vectors) / unit
        points = extend(found, landmarks, np.square(squared, dtype=np.float32), refine=dimensions > 1, threads=threads)
        points[landmarks] = found
    posed = principal_pose(points * unit, np.ones(len(points)))
    return ClassMap(posed, stress(found, distances / unit), landmarks)


def _landmarks(vectors: Singles, measure: VectorMeasure) -> Indices:
    """Return the shapes that stand for all: evenly by their distance from the middle, the first of them mixed.

    They are as dense as the shapes are, whatever the order these came in.
    """
    count = len(vectors)
    if count <= LANDMARKS:
        return np.arange(count)
    middle = vectors.mean(axis=0, dtype=np.float64).astype(np.float32)
    outwards = np.argsort(measure.distances(middle, vectors), kind="stable")
    even = outwards[np.linspace(0, count - 1, LANDMARKS).astype(np.int64)]
    return np.random.default_rng(0).permutation(even)
