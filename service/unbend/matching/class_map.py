"""The class map: points for shapes, whose distances approximate a measure (section 2.3 and Fig. 8: D_M)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from unbend.arrays import Floats, Indices, Singles, frozen
from unbend.brief import brief, counted_points
from unbend.descriptors.pose import principal_pose
from unbend.embedding.embed import embed
from unbend.embedding.extension import extend
from unbend.embedding.stress import stress
from unbend.matching.measures import VectorMeasure

MAX_LANDMARKS: Final = 2000
"""Largest number of landmarks, which are the shapes embedded by all distances between them.

Further shapes are placed by their distances to some landmarks.
"""

_ANCHORS: Final = 200
"""Number of landmarks by whose distances a further shape is placed."""


@dataclass(frozen=True, eq=False)
class ClassMap:
    """A point for each shape, in the principal axes of all. Distances define the map up to rotation and reflection."""

    points: Floats
    """(n, m)."""
    stress: float
    """Stress of the landmarks (eq. 2 of the paper). It is 0 if the map is exact."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", frozen(self.points, np.float64))

    def __repr__(self) -> str:
        return brief(self, counted_points(self.points.shape), f"stress {self.stress:.3g}")


def class_map(vectors: Singles, measure: VectorMeasure, dimensions: int = 2, *, threads: int | None = None) -> ClassMap:
    """Place shapes so that Euclidean distances approximate those under `measure`.

    Parameters
    ----------
    vectors : (n, d) float32
        One finite vector per shape.
    measure : VectorMeasure
    dimensions : int, default 2
    threads : int, optional
        All cores by default. The result does not depend on it.

    Returns
    -------
    ClassMap
        The same for the same input on every run.

    Raises
    ------
    ParameterError
        If `dimensions` or `threads` is below 1.
    """
    landmarks = _landmarks(vectors, measure)
    distances = measure.matrix(vectors[landmarks])
    if not distances.any():  # no shape, a single one, or only copies of one
        return ClassMap(np.zeros((len(vectors), dimensions)), 0.0)
    # Depending on the measure, distances may be 1e-4 or 1e4. The steps below need distances near 1.
    unit = float(distances.max())
    embedded = embed(distances / unit, dimensions, threads=threads).points
    points = embedded
    if len(landmarks) < len(vectors):
        to_anchors = measure.between(vectors[landmarks[:_ANCHORS]], vectors) / unit
        squares = np.square(to_anchors, dtype=np.float32)
        points = extend(embedded, landmarks, squares, refine=dimensions > 1, threads=threads)
        points[landmarks] = embedded
    posed = principal_pose(points * unit, np.ones(len(points)))
    return ClassMap(posed, stress(embedded, distances / unit))


def _landmarks(vectors: Singles, measure: VectorMeasure) -> Indices:
    """Return the rows of the shapes that are embedded: all rows, or a sample in random order.

    The sample is evenly spaced among the shapes sorted by distance from their mean. So its density follows that of the
    shapes, whatever the order of the rows.
    """
    count = len(vectors)
    if count <= MAX_LANDMARKS:
        return np.arange(count)
    mean = vectors.mean(axis=0, dtype=np.float64).astype(np.float32)
    by_distance = np.argsort(measure.distances(mean, vectors), kind="stable")
    sample = by_distance[np.linspace(0, count - 1, MAX_LANDMARKS).astype(np.int64)]
    return np.random.default_rng(0).permutation(sample)
