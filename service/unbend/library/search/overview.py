"""Overviews of a library under a measure: a map of its shapes, and an evaluation of retrieval."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, get_args

import numpy as np
from sqlalchemy import Connection

from unbend.arrays import Indices, Singles
from unbend.errors import ParameterError, check_choice
from unbend.library.search.index import Snapshot
from unbend.library.shape_rows import get_matches
from unbend.matching.class_map import class_map
from unbend.matching.evaluate import evaluate
from unbend.matching.gallery import UNLABELLED
from unbend.matching.measures import VectorMeasure
from unbend.matching.measures.protocol import squared
from unbend.matching.measures.vectors import SURFACE_MOMENTS
from unbend.results.evaluations import EvaluationResult
from unbend.results.maps import MapDistance, MapItem, ShapeMap
from unbend.results.rankings import ShapeMatch

MAP_LIMIT: Final = 5000
"""Largest number of shapes on a map by default."""

_PAIRS: Final = 20_000_000
"""Largest number of distances that an evaluation computes. In large libraries, not every shape is a query."""


@dataclass(frozen=True)
class MapOptions:
    """The size of a map, and its distances."""

    dimensions: int = 2
    limit: int = MAP_LIMIT
    distance: MapDistance = "l1"

    def __post_init__(self) -> None:
        for name in ("dimensions", "limit"):
            if getattr(self, name) < 1:
                raise ParameterError(f"{name} must be at least 1, not {getattr(self, name)}")
        check_choice("distance", self.distance, get_args(MapDistance))


@dataclass(frozen=True)
class Selection:
    """The shapes of a map, and their vectors."""

    vectors: Singles
    originals: Singles
    names: Sequence[ShapeMatch]
    count: int
    """Number of shapes that these were chosen from."""


def select(connection: Connection, snapshot: Snapshot, original: Snapshot, limit: int) -> Selection:
    """Choose at most `limit` of the shapes in both snapshots, evenly over the order of adding."""
    seqs = np.intersect1d(_searchable(snapshot), _searchable(original), assume_unique=True)
    chosen = seqs[np.linspace(0, len(seqs) - 1, min(limit, len(seqs))).astype(np.int64)]
    vectors, originals = (of.gallery.vectors[np.searchsorted(of.seqs, chosen)] for of in (snapshot, original))
    names = get_matches(connection, chosen.tolist(), [0.0] * len(chosen))
    return Selection(vectors, originals, names, len(seqs))


def map_of(selection: Selection, measure: VectorMeasure, options: MapOptions) -> ShapeMap:
    """Embed shapes by `measure`, and by their surfaces in space."""
    by, original = measure, SURFACE_MOMENTS
    if options.distance == "squared_l2":
        by, original = squared(by), squared(original)
    found = class_map(selection.vectors, by, options.dimensions)
    others = class_map(selection.originals, original, options.dimensions)
    items = [
        MapItem(match.id, match.name, match.label, point, other)
        for match, point, other in zip(selection.names, found.points.tolist(), others.points.tolist(), strict=True)
    ]
    return ShapeMap(measure.name, found.stress, others.stress, selection.count, items)


def _searchable(snapshot: Snapshot) -> Indices:
    return np.delete(snapshot.seqs, snapshot.excluded)


def evaluation_of(snapshot: Snapshot, measure: VectorMeasure) -> EvaluationResult:
    """Rank the other labelled shapes for every labelled shape, or for as many of them as `_PAIRS` allows.

    Raises
    ------
    UnsuitedError
        If no class has two members.
    """
    gallery = snapshot.gallery
    labelled = np.flatnonzero(gallery.codes != UNLABELLED)
    vectors = gallery.vectors[labelled]
    affordable = max(1, _PAIRS // max(1, len(labelled)))
    queries = np.arange(len(labelled))
    if len(labelled) > affordable:
        queries = np.linspace(0, len(labelled) - 1, affordable).astype(np.int64)
    distances = measure.between(vectors[queries], vectors)
    labels = [gallery.labels[code] for code in gallery.codes[labelled]]
    found = evaluate(distances, [labels[query] for query in queries], labels, own=queries)
    return EvaluationResult.of(measure.name, found)
