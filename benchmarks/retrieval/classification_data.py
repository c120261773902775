"""Data for measuring the classifiers: real shapes in random libraries of several sizes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np

from benchmarks.retrieval.data import half, listed, signatures_of
from unbend.matching.classification.classifier import Query
from unbend.matching.gallery import Gallery
from unbend.matching.measures import VECTOR_MEASURES
from unbend.signature.parameters import Parameters

ALL: Final = None
"""The size of a library that contains all shapes except the query."""
DRAWS: Final = 3
"""Random libraries of each size."""
CHOOSING, REPORTING = 0, 1
"""Arguments of `benchmarks.retrieval.data.half`: one half of the classes chooses constants, the other is reported."""


@dataclass(frozen=True, eq=False)
class Shapes:
    """A data set: labels, and vectors by measure."""

    title: str
    labels: np.ndarray
    vectors: dict[str, np.ndarray]


@dataclass(frozen=True)
class Trial:
    """A query with its library, which may lack the query's class, and that class."""

    query: Query
    label: str


def load(dataset: str, title: str) -> Shapes:
    paths, labels = listed(dataset)
    signatures = signatures_of(paths, Parameters())
    vectors = {
        name: np.stack([measure.vector(signature.descriptors) for signature in signatures])
        for name, measure in VECTOR_MEASURES.items()
    }
    return Shapes(title, np.array(labels), vectors)


def split(shapes: Shapes, members: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Draw `members` random rows of each class; return these rows and the other rows."""
    generator = np.random.default_rng(seed)
    drawn = [generator.permutation(np.flatnonzero(shapes.labels == label)) for label in np.unique(shapes.labels)]
    return np.concatenate([rows[:members] for rows in drawn]), np.concatenate([rows[members:] for rows in drawn])


@cache
def trials(shapes: Shapes, measure: str, members: int | None, which: int, *, known: bool = True) -> list[Trial]:
    """Return queries by shapes of one half of the classes, in libraries of `members` shapes of every class.

    Each shape that is not in a library is a query. If `known`, only queries with another shape of their class in
    the library count. Otherwise the library lacks the query's class.
    """
    return [
        trial
        for gallery, rows in _libraries(shapes, measure, members)
        for row in rows[half(shapes.labels[rows].tolist(), which)]
        if (trial := _trial(shapes, measure, gallery, row, members is ALL, known))
    ]


def _libraries(shapes: Shapes, measure: str, members: int | None) -> Iterator[tuple[Gallery, np.ndarray]]:
    """Yield galleries and the rows of `shapes` that are their queries; if a gallery has all shapes, each is a query."""
    vectors = shapes.vectors[measure]
    if members is ALL:
        yield Gallery.of(vectors, shapes.labels.tolist()), np.arange(len(vectors))
        return
    for seed in range(DRAWS):
        held, asked = split(shapes, members, seed)
        yield Gallery.of(vectors[held], shapes.labels[held].tolist()), asked


def _trial(shapes: Shapes, measure: str, gallery: Gallery, row: int, held: bool, known: bool) -> Trial | None:
    vector, label = shapes.vectors[measure][row], str(shapes.labels[row])
    distances = VECTOR_MEASURES[measure].distances(vector, gallery.vectors)
    if held:
        distances[row] = np.inf
    own = gallery.labels.index(label)
    if not known:
        distances[gallery.codes == own] = np.inf
    query = Query(gallery, VECTOR_MEASURES[measure], vector, distances)
    return Trial(query, label) if not known or query.nearest[own] < np.inf else None
