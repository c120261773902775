"""Answering a query: search by vectors, classes, and the nearest in order anew where a measure compares whole pairs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from sqlalchemy import Connection

from unbend.errors import NotFoundError, ParameterError
from unbend.library import shapes as rows
from unbend.library.engine import Store
from unbend.library.index import IndexKey, VectorIndex
from unbend.library.payload import unpack_signature
from unbend.library.records import ShapeMatch
from unbend.matching.classification import ClassMatch, classify, get_classifier
from unbend.matching.measures import DEFAULT_MEASURE, PairMeasure, VectorMeasure, get_measure, get_vector_measure
from unbend.matching.rerank import SHORTLIST, rerank
from unbend.matching.selection import smallest
from unbend.signature.signature import Signature

MOST_PAIRS: Final = 100
"""Shapes that may be asked for where each is compared whole: a few milliseconds a piece."""


@dataclass(frozen=True)
class Ranking:
    """What a query is and what is like it, best first."""

    measure: str
    classes: Sequence[ClassMatch]
    shapes: Sequence[ShapeMatch]
    known: bool | None
    """Whether the best class is near enough; None where the library cannot tell."""
    warnings: Sequence[str] = ()
    """Sentences that say why the answer may be wrong, and what to do."""

    def as_dict(self) -> dict[str, Any]:
        """Return the ranking as plain JSON values, as the HTTP contract has it."""
        return {  # not by `asdict`, which takes longer over a thousand classes than the search does
            "measure": self.measure,
            "classes": [dict(vars(match)) for match in self.classes],
            "shapes": [dict(vars(match)) for match in self.shapes],
            "known": self.known,
            "warnings": list(self.warnings),
        }


@dataclass(frozen=True)
class Question:
    """What is asked of a query, checked."""

    measure: VectorMeasure
    """What the search goes by."""
    pairs: PairMeasure | None
    """What its nearest are put in order by."""
    classifier: str
    k: int

    @classmethod
    def of(cls, measure: str, classifier: str, k: int) -> Question:
        """Make one, or raise ParameterError."""
        if k < 1:
            raise ParameterError(f"k must be at least 1, not {k}")
        chosen, classes = get_measure(measure), get_classifier(classifier).name
        if not isinstance(chosen, PairMeasure):
            return cls(get_vector_measure(measure), None, classes, k)
        if k > MOST_PAIRS:
            raise ParameterError(f"k must be at most {MOST_PAIRS} with {measure}, which compares whole shapes, not {k}")
        return cls(get_vector_measure(DEFAULT_MEASURE), chosen, classes, k)

    @property
    def name(self) -> str:
        """The measure that was asked for."""
        return (self.pairs or self.measure).name


def rank(store: Store, index: VectorIndex, query: Signature | str, asked: Question) -> Ranking:
    """Rank what `store` holds.

    Raises
    ------
    NotFoundError
        If there is no such shape.
    UnsuitedError
        If the classifier needs more labels.
    """
    key, seq, warnings = _compared_with(store, query, asked.measure)
    with store.read() as connection:
        held = index.get(connection, key)
        if isinstance(query, Signature):
            vector = asked.measure.vector(query.descriptors)
        else:
            row = held.row(seq)
            if row is None:
                raise NotFoundError(f"no shape {query} that {asked.measure.name} can compare")
            vector, held = held.gallery.vectors[row], held.without(row)
        if not len(held):
            return Ranking(asked.name, [], [], None, warnings)
        distances = held.distances(vector, asked.measure)
        nearest = smallest(distances, asked.k if asked.pairs is None else max(asked.k, SHORTLIST))
        matches = rows.get_matches(connection, held.seqs[nearest].tolist(), distances[nearest].tolist())
        if asked.pairs is not None:
            matches = _reordered(connection, query, matches, asked.pairs)[: asked.k]
    found = classify(held.gallery, asked.measure, vector, distances, asked.classifier)
    return Ranking(asked.name, found.matches, matches, found.known, warnings)


def _compared_with(store: Store, query: Signature | str, measure: VectorMeasure) -> tuple[IndexKey, int, Sequence[str]]:
    """Return what a query is compared with, its place in the order of adding (0 if not stored), and its warnings."""
    if isinstance(query, Signature):
        return IndexKey(measure, query.parameters.to_json(), query.version), 0, query.warnings
    with store.read() as connection:  # of its own, for the index must see the store no earlier than others did
        seq, parameters, version, warnings = rows.get_place(connection, query)
    return IndexKey(measure, parameters, version), seq, warnings


def _reordered(
    connection: Connection, query: Signature | str, matches: Sequence[ShapeMatch], measure: PairMeasure
) -> list[ShapeMatch]:
    own = query if isinstance(query, Signature) else _signature(connection, query)
    distances = rerank(own, [_signature(connection, match.id) for match in matches], measure)
    order = np.argsort(distances, kind="stable").tolist()
    return [replace(matches[place], distance=float(distances[place])) for place in order]


def _signature(connection: Connection, shape_id: str) -> Signature:
    return unpack_signature(rows.get_signature_payload(connection, shape_id))
