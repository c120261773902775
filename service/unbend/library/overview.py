"""The library as a whole under a measure: a map of its shapes, and how well it finds its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final, Literal, get_args

import numpy as np
from sqlalchemy import Connection

from unbend.arrays import Indices, Singles
from unbend.errors import ParameterError
from unbend.library.records import ShapeMatch
from unbend.library.shapes import get_matches
from unbend.library.table import Held
from unbend.matching.class_map import class_map
from unbend.matching.evaluate import Evaluation, evaluate
from unbend.matching.gallery import UNLABELLED
from unbend.matching.measures import VectorMeasure
from unbend.matching.measures.moments import SURFACE_MOMENTS
from unbend.matching.measures.protocol import squared

MAP_LIMIT: Final = 5000
"""Shapes that a map shows by default."""

_PAIRS: Final = 20_000_000
"""Distances that an evaluation may take: beyond, fewer shapes are asked, of all others."""


MapDistance = Literal["l1", "squared_l2"]


@dataclass(frozen=True)
class Shown:
    """How much a map shows, and what its distances are."""

    dimensions: int = 2
    limit: int = MAP_LIMIT
    distance: MapDistance = "l1"

    def __post_init__(self) -> None:
        for name in ("dimensions", "limit"):
            if getattr(self, name) < 1:
                raise ParameterError(f"{name} must be at least 1, not {getattr(self, name)}")
        if self.distance not in get_args(MapDistance):
            raise ParameterError(f"distance must be one of {', '.join(get_args(MapDistance))}, not {self.distance!r}")


@dataclass(frozen=True)
class MapItem:
    """A shape and its place."""

    id: str
    name: str
    label: str | None
    point: Sequence[float]
    """By its signature."""
    original: Sequence[float]
    """By its surface as it stands: the paper's Fig. 8 has both side by side."""


@dataclass(frozen=True)
class ShapeMap:
    """Shapes as points whose distances are those of their descriptors."""

    measure: str
    stress: float
    """Eq. 2 of the points."""
    original_stress: float
    """Eq. 2 of the originals."""
    count: int
    """Shapes that could be shown."""
    items: list[MapItem]

    def as_dict(self) -> dict[str, Any]:
        """Return the map as plain JSON values, as the HTTP contract has it."""
        return asdict(self)


@dataclass(frozen=True)
class Selection:
    """The shapes of a map, and what it is made of."""

    vectors: Singles
    originals: Singles
    names: Sequence[ShapeMatch]
    count: int
    """Shapes that could have been chosen."""


def select(connection: Connection, held: Held, original: Held, limit: int) -> Selection:
    """Choose at most `limit` of the shapes that are in both, evenly over the order of adding."""
    seqs = np.intersect1d(_present(held), _present(original), assume_unique=True)
    chosen = seqs[np.linspace(0, len(seqs) - 1, min(limit, len(seqs))).astype(np.int64)]
    vectors, originals = (of.gallery.vectors[np.searchsorted(of.seqs, chosen)] for of in (held, original))
    names = get_matches(connection, chosen.tolist(), [0.0] * len(chosen))
    return Selection(vectors, originals, names, len(seqs))


def map_of(selection: Selection, measure: VectorMeasure, shown: Shown) -> ShapeMap:
    """Place shapes under `measure`, and beside that as they stand."""
    by, original = measure, SURFACE_MOMENTS
    if shown.distance == "squared_l2":
        by, original = squared(by), squared(original)
    found = class_map(selection.vectors, by, shown.dimensions)
    others = class_map(selection.originals, original, shown.dimensions)
    items = [
        MapItem(match.id, match.name, match.label, point, other)
        for match, point, other in zip(selection.names, found.points.tolist(), others.points.tolist(), strict=True)
    ]
    return ShapeMap(measure.name, found.stress, others.stress, selection.count, items)


def _present(held: Held) -> Indices:
    return np.delete(held.seqs, held.left_out)


def evaluation_of(held: Held, measure: VectorMeasure) -> Evaluation:
    """Ask every labelled shape, or as many as is affordable, of all other labelled ones.

    Raises
    ------
    ParameterError
        If no class has two members.
    """
    gallery = held.gallery
    labelled = np.flatnonzero(gallery.codes != UNLABELLED)
    vectors = gallery.vectors[labelled]
    affordable = max(1, _PAIRS // max(1, len(labelled)))
    asked = np.arange(len(labelled))
    if len(labelled) > affordable:
        asked = np.linspace(0, len(labelled) - 1, affordable).astype(np.int64)
    distances = measure.between(vectors[asked], vectors)
    labels = [gallery.labels[code] for code in gallery.codes[labelled]]
    return evaluate(distances, [labels[query] for query in asked], labels, own=asked)
