"""Rankings of shapes by their vectors, and of classes; measures of whole shapes reorder the nearest shapes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from sqlalchemy import Connection

from unbend.errors import NotFoundError
from unbend.library import shape_rows
from unbend.library.requests import QueryRequest
from unbend.library.search.filters import filter_of, kept_seqs
from unbend.library.search.incomparable import none_compares, why_none_compares
from unbend.library.search.index import IndexKey, SearchIndex
from unbend.library.search.nearest import SearchChoice, choose_partition, find_nearest
from unbend.library.search.nearest_classes import FROM_CANDIDATES, SampledClasses, classify_nearest
from unbend.library.storage.store import Store
from unbend.library.vector_rows import Partition, VectorKind
from unbend.matching.classification import Classification, classify
from unbend.matching.measures import PairMeasure, VectorMeasure
from unbend.matching.rerank import SHORTLIST, rerank
from unbend.matching.selection import smallest
from unbend.results.rankings import Ranking, ShapeMatch
from unbend.signature.signature import Signature
from unbend.tolerances import PIECE_BOUNDARY


@dataclass(frozen=True)
class _Found:
    """The shapes nearest to a query, and its classes."""

    seqs: Sequence[int]
    distances: Sequence[float]
    classes: Classification
    is_exact: bool = True


@dataclass(frozen=True)
class Ranker:
    """Ranks the content of a store, by an index in memory or by the database."""

    store: Store
    index: SearchIndex
    samples: SampledClasses
    choice: SearchChoice

    def rank(self, query: Signature | str, request: QueryRequest) -> Ranking:
        """Rank classes and shapes.

        Raises
        ------
        NotFoundError
            If there is no such shape.
        UnsuitedError
            If the classifier needs more labels.
        VectorsMissingError
            If the database shall search, and has no vectors.
        """
        measure, pair_measure = request.vector_measure, request.pair_measure
        # Read in a separate transaction, because the index's transaction must begin with `SearchIndex.snapshot`.
        with self.store.read() as connection:
            key, seq, warnings = _key_of(connection, query, measure)
            partition = self._partition(connection, key, request)
        count = max(request.k, SHORTLIST) if pair_measure else request.k
        with self.store.read() as connection:
            if partition is None:
                found = self._in_memory(connection, key, seq, query, request, count)
            else:
                found = self._by_database(connection, partition, seq, query, request, count)
            if found is None:
                reason = why_none_compares(connection, key.parameters, key.version, seq)
                return Ranking(request.measure, [], [], None, (*warnings, *none_compares(reason)))
            matches = shape_rows.get_matches(connection, found.seqs, found.distances)
            if pair_measure:
                matches = _reranked(connection, query, matches, pair_measure)[: request.k]
            boundaries = shape_rows.get_boundaries(connection, [seq, *found.seqs[:1]])
        own = query.boundary if isinstance(query, Signature) else boundaries[0]
        warnings = (*warnings, *_doubts(own, boundaries[-1]))
        classes = found.classes
        return Ranking(request.measure, classes.matches, matches, classes.known, warnings, found.is_exact)

    def _in_memory(
        self, connection: Connection, key: IndexKey, seq: int, query: Signature | str, request: QueryRequest, count: int
    ) -> _Found | None:
        """Search the index in memory; None if no shape compares."""
        snapshot = self.index.snapshot(connection, key)
        if isinstance(query, Signature):
            vector = key.measure.vector(query.descriptors)
        else:
            row = snapshot.row(seq)
            if row is None:
                raise NotFoundError(f"no shape {query} that {key.measure.name} can compare")
            vector, snapshot = snapshot.gallery.vectors[row], snapshot.without(row)
        kept = kept_seqs(connection, filter_of(request))
        if kept is not None:
            snapshot = snapshot.only(kept)
        if not len(snapshot):
            return None
        distances = snapshot.distances(vector, key.measure)
        nearest = smallest(distances, count)
        classes = classify(snapshot.gallery, key.measure, vector, distances, request.classifier)
        return _Found(snapshot.seqs[nearest].tolist(), distances[nearest].tolist(), classes)

    def _partition(self, connection: Connection, key: IndexKey, request: QueryRequest) -> Partition | None:
        """Return the vectors of the database that answer a query; None if the index in memory answers it."""
        if request.classifier not in FROM_CANDIDATES:
            return None
        return choose_partition(connection, VectorKind(key.measure, key.parameters, key.version), self.choice)

    def _by_database(
        self,
        connection: Connection,
        partition: Partition,
        seq: int,
        query: Signature | str,
        request: QueryRequest,
        count: int,
    ) -> _Found | None:
        """Search the vectors of the database; None if no shape compares."""
        measure = partition.kind.measure
        stored = query.descriptors if isinstance(query, Signature) else shape_rows.get_descriptors(connection, seq)
        if not all(name in stored for name, _ in measure.parts):
            raise NotFoundError(f"no shape {query} that {measure.name} can compare")
        vector = measure.vector(stored)
        only = filter_of(request)
        near = find_nearest(connection, partition, vector, count, only, without=seq, exact=request.exact)
        if not len(near.seqs):
            return None
        samples = self.samples.of(connection, partition)
        classes = classify_nearest(
            connection, partition, vector, samples, request.classifier, only, without=seq, exact=request.exact
        )
        return _Found(near.seqs.tolist(), near.distances.tolist(), classes, near.is_exact)


def _doubts(own: float | None, nearest: float | None) -> tuple[str, ...]:
    """Return a warning if only one of a query and the nearest shape has the boundary of a piece."""
    if own is None or nearest is None or (own > PIECE_BOUNDARY) == (nearest > PIECE_BOUNDARY):
        return ()
    which, other = ("mesh", "nearest shape") if own > PIECE_BOUNDARY else ("nearest shape", "mesh")
    return (f"the {which} is open and the {other} is not: if it is a piece, ask with the measure `partial`",)


def _key_of(
    connection: Connection, query: Signature | str, measure: VectorMeasure
) -> tuple[IndexKey, int, Sequence[str]]:
    """Return the key of comparable shapes, the query's place in the order of adding (0 if not stored), and warnings."""
    if isinstance(query, Signature):
        return IndexKey(measure, query.parameters.to_json(), query.version), 0, query.warnings
    seq, parameters, version, warnings = shape_rows.get_place(connection, query)
    return IndexKey(measure, parameters, version), seq, warnings


def _reranked(
    connection: Connection, query: Signature | str, matches: Sequence[ShapeMatch], measure: PairMeasure
) -> list[ShapeMatch]:
    own = query if isinstance(query, Signature) else shape_rows.get_signature(connection, query)
    distances = rerank(own, [shape_rows.get_signature(connection, match.id) for match in matches], measure)
    order = np.argsort(distances, kind="stable").tolist()
    return [replace(matches[row], distance=float(distances[row])) for row in order]
