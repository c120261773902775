"""What the classifiers are measured on: real shapes, drawn into libraries of several sizes."""

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
"""A library's size a class: all shapes but the query."""
DRAWS: Final = 3
"""Random libraries of each size."""
CHOOSING, REPORTING = 0, 1
"""The halves of the classes, as `retrieval_data.half` has them, whose queries choose constants and report figures."""


@dataclass(frozen=True, eq=False)
class Shapes:
    """A data set."""

    title: str
    labels: np.ndarray
    vectors: dict[str, np.ndarray]


@dataclass(frozen=True)
class Trial:
    """A query, its class and the library that it is put to, which may be without that class."""

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
    """Draw `members` rows of each class, and return them and the others."""
    generator = np.random.default_rng(seed)
    drawn = [generator.permutation(np.flatnonzero(shapes.labels == label)) for label in np.unique(shapes.labels)]
    return np.concatenate([rows[:members] for rows in drawn]), np.concatenate([rows[members:] for rows in drawn])


@cache
def trials(shapes: Shapes, measure: str, members: int | None, which: int, *, known: bool = True) -> list[Trial]:
    """Put the shapes of one half of the classes to libraries of `members` shapes of every class.

    Those that are not in a library are asked of it. Unless `known`, their own class is left out of it; otherwise
    those are asked of whose class there is another shape.
    """
    return [
        trial
        for gallery, rows in _libraries(shapes, measure, members)
        for row in rows[half(shapes.labels[rows].tolist(), which)]
        if (trial := _trial(shapes, measure, gallery, row, members is ALL, known))
    ]


def _libraries(shapes: Shapes, measure: str, members: int | None) -> Iterator[tuple[Gallery, np.ndarray]]:
    """Yield galleries, and the rows of `shapes` that are asked of them; a gallery of all shapes is asked of itself."""
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
