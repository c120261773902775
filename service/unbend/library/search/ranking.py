"""Rankings of shapes by their vectors, and of classes; measures of whole shapes reorder the nearest shapes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from sqlalchemy import Connection

from unbend.errors import NotFoundError
from unbend.library import shape_rows
from unbend.library.requests import QueryRequest
from unbend.library.search.incomparable import none_compares, why_none_compares
from unbend.library.search.index import IndexKey, SearchIndex
from unbend.library.storage.store import Store
from unbend.matching.classification import classify
from unbend.matching.measures import PairMeasure, VectorMeasure
from unbend.matching.rerank import SHORTLIST, rerank
from unbend.matching.selection import smallest
from unbend.results.rankings import Ranking, ShapeMatch
from unbend.signature.signature import Signature
from unbend.tolerances import PIECE_BOUNDARY


def rank(store: Store, index: SearchIndex, query: Signature | str, request: QueryRequest) -> Ranking:
    """Rank the content of `store`.

    Raises
    ------
    NotFoundError
        If there is no such shape.
    UnsuitedError
        If the classifier needs more labels.
    """
    measure, pair_measure = request.vector_measure, request.pair_measure
    key, seq, warnings = _key_of(store, query, measure)
    with store.read() as connection:
        snapshot = index.snapshot(connection, key)
        if isinstance(query, Signature):
            vector = measure.vector(query.descriptors)
        else:
            row = snapshot.row(seq)
            if row is None:
                raise NotFoundError(f"no shape {query} that {measure.name} can compare")
            vector, snapshot = snapshot.gallery.vectors[row], snapshot.without(row)
        if not len(snapshot):
            reason = why_none_compares(connection, key.parameters, key.version, seq)
            return Ranking(request.measure, [], [], None, (*warnings, *none_compares(reason)))
        distances = snapshot.distances(vector, measure)
        nearest = smallest(distances, max(request.k, SHORTLIST) if pair_measure else request.k)
        matches = shape_rows.get_matches(connection, snapshot.seqs[nearest].tolist(), distances[nearest].tolist())
        if pair_measure:
            matches = _reranked(connection, query, matches, pair_measure)[: request.k]
        boundaries = shape_rows.get_boundaries(connection, [seq, *snapshot.seqs[nearest[:1]].tolist()])
    own = query.boundary if isinstance(query, Signature) else boundaries[0]
    found = classify(snapshot.gallery, measure, vector, distances, request.classifier)
    warnings = (*warnings, *_doubts(own, boundaries[-1]))
    return Ranking(request.measure, found.matches, matches, found.known, warnings)


def _doubts(own: float | None, nearest: float | None) -> tuple[str, ...]:
    """Return a warning if only one of a query and the nearest shape has the boundary of a piece."""
    if own is None or nearest is None or (own > PIECE_BOUNDARY) == (nearest > PIECE_BOUNDARY):
        return ()
    which, other = ("mesh", "nearest shape") if own > PIECE_BOUNDARY else ("nearest shape", "mesh")
    return (f"the {which} is open and the {other} is not: if it is a piece, ask with the measure `partial`",)


def _key_of(store: Store, query: Signature | str, measure: VectorMeasure) -> tuple[IndexKey, int, Sequence[str]]:
    """Return the key of comparable shapes, the query's place in the order of adding (0 if not stored), and warnings."""
    if isinstance(query, Signature):
        return IndexKey(measure, query.parameters.to_json(), query.version), 0, query.warnings
    # Read in a separate transaction, because the index's transaction must begin with `SearchIndex.snapshot`.
    with store.read() as connection:
        seq, parameters, version, warnings = shape_rows.get_place(connection, query)
    return IndexKey(measure, parameters, version), seq, warnings


def _reranked(
    connection: Connection, query: Signature | str, matches: Sequence[ShapeMatch], measure: PairMeasure
) -> list[ShapeMatch]:
    own = query if isinstance(query, Signature) else shape_rows.get_signature(connection, query)
    distances = rerank(own, [shape_rows.get_signature(connection, match.id) for match in matches], measure)
    order = np.argsort(distances, kind="stable").tolist()
    return [replace(matches[row], distance=float(distances[row])) for row in order]
