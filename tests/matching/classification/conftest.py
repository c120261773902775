"""Fixtures for tests of classifiers: galleries of points with the L1 distance."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from unbend.matching.classification import Classification, classify
from unbend.matching.gallery import Gallery
from unbend.matching.measures import get_vector_measure

MEASURE = get_vector_measure("moments")


@pytest.fixture(scope="session")
def ask() -> Callable[..., Classification]:
    """A function that classifies a point in a gallery; rows left out get an infinite distance."""

    def of(gallery: Gallery, point: object, classifier: str = "nearest", left_out: object = ()) -> Classification:
        query = np.atleast_1d(np.asarray(point, np.float32))
        distances = MEASURE.distances(query, gallery.vectors)
        distances[list(left_out)] = np.inf
        return classify(gallery, MEASURE, query, distances, classifier)

    return of


@pytest.fixture(scope="session")
def clouds() -> Callable[..., Gallery]:
    """A function that makes galleries with one cloud of points per class, wider along each further axis."""

    def of(seed: int, classes: int = 3, members: int = 6, dimension: int = 4, unlabelled: int = 0) -> Gallery:
        random = np.random.default_rng(seed)
        centres = random.normal(size=(classes, 1, dimension)) * 3
        points = (centres + random.normal(size=(classes, members, dimension)) * np.arange(1, dimension + 1)).reshape(
            -1, dimension
        )
        labels = [f"class {code}" for code in range(classes) for _ in range(members)] + [None] * unlabelled
        points = np.concatenate([points, random.normal(size=(unlabelled, dimension))])
        order = random.permutation(len(points))
        return Gallery.of(points[order].astype(np.float32), [labels[row] for row in order])

    return of
