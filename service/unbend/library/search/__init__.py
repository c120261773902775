"""Search in a library: rankings of queries, evaluation, and the class map."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Final, Literal, get_args

from sqlalchemy import Connection

from unbend.errors import UnsuitedError, VectorsMissingError, check_choice
from unbend.library import shape_rows, vector_rows
from unbend.library.requests import QueryRequest
from unbend.library.search.incomparable import ADVICE, none_compares, why_none_compares
from unbend.library.search.index import IndexKey, SearchIndex
from unbend.library.search.nearest import SearchChoice, choose_partition
from unbend.library.search.nearest_classes import SampledClasses
from unbend.library.search.overview import MapOptions, evaluation_of, map_of, select
from unbend.library.search.parts import PartIndex, rank_parts
from unbend.library.search.ranking import Ranker
from unbend.library.search.recall import measure_recall
from unbend.library.storage.store import Store
from unbend.library.storage.transactions import as_store_error
from unbend.library.vector_rows import VectorKind
from unbend.matching.measures import DEFAULT_MEASURE, VectorMeasure, get_vector_measure
from unbend.matching.measures.vectors import SURFACE_MOMENTS
from unbend.results.evaluations import EvaluationResult
from unbend.results.maps import ShapeMap
from unbend.results.rankings import Ranking
from unbend.signature.parameters import Parameters
from unbend.signature.signature import ALGORITHM_VERSION, Signature

__all__ = ["MapOptions", "Search", "SearchChoice"]


_DEFAULT_KIND: Final = VectorKind(get_vector_measure(DEFAULT_MEASURE), Parameters().to_json(), ALGORITHM_VERSION)


@dataclass(frozen=True)
class SearchStatus:
    """The searcher, and how well it searches."""

    by: Literal["memory", "database"]
    recall: float | None
    """Share of the ten nearest shapes that the database finds, as measured last; None for the exact index in memory."""


class Search:
    """Search among the shapes of a store; thread-safe.

    Parameters
    ----------
    store : Store
    choice : {"auto", "memory", "database"}
        Who searches: an index in memory, or the database if it has vectors (`vector_rows`). By default the index in
        memory, until it becomes too large.
    """

    def __init__(self, store: Store, choice: SearchChoice = "auto") -> None:
        check_choice("search", choice, get_args(SearchChoice))
        self._store = store
        self._index = SearchIndex()
        self._parts = PartIndex()
        self._choice: SearchChoice = choice
        self._ranker = Ranker(store, self._index, SampledClasses(), choice)

    def rank(self, query: Signature | str, request: QueryRequest) -> Ranking:
        """Rank classes and shapes by their distance from `query`: a signature, or the id of a stored shape.

        Only shapes whose signatures were computed with the query's parameters take part.

        Raises
        ------
        NotFoundError
            If there is no such shape.
        UnsuitedError
            If the classifier needs more labels.
        ParameterError
            If a measure of parts is asked about a signature without local signatures.
        """
        if request.part_measure:
            return rank_parts(self._store, self._parts, query, request)
        return self._ranker.rank(query, request)

    def prepare_vectors(self) -> None:
        """Make the vectors by which PostgreSQL searches, add missing ones, and build missing indexes.

        Do nothing if another process builds indexes. This takes minutes for a large library, and others may use the
        library meanwhile.

        Raises
        ------
        VectorsMissingError
            If the database cannot have vectors.
        """
        if self._store.postgres is None:
            raise VectorsMissingError("a library in SQLite is searched by an index in memory")
        self._store.change(vector_rows.create_vectors)
        with as_store_error():
            vector_rows.fill(self._store.engine)
            vector_rows.build_indexes(self._store.engine)

    def measure_recall(self) -> float:
        """Measure and store the recall at ten of the search by the database, among shapes of default parameters.

        It is 1 if there are too few shapes for an index.
        """
        with self._store.read() as connection:
            partition = vector_rows.find_partition(connection, _DEFAULT_KIND)
            recall = measure_recall(connection, partition) if partition else 1.0
        self._store.change(partial(vector_rows.set_recall, recall=recall))
        return recall

    def status(self) -> SearchStatus:
        """Return who searches among shapes of default parameters, and the recall measured last."""

        def load(connection: Connection) -> SearchStatus:
            partition = choose_partition(connection, _DEFAULT_KIND, self._choice)
            if partition is None:
                return SearchStatus("memory", None)
            return SearchStatus("database", vector_rows.get_recall(connection))

        return self._store.load(load)

    def evaluation(self, measure: str, parameters: Parameters | None = None) -> EvaluationResult:
        """Evaluate retrieval among the labelled shapes computed with `parameters`.

        Raises
        ------
        ParameterError
            If there is no such measure, or it does not compare vectors; UnsuitedError if no shape has these parameters,
            or no class has two members.
        """
        chosen = get_vector_measure(measure)
        key = _key(chosen, parameters)
        with self._store.read() as connection:
            snapshot = self._index.snapshot(connection, key)
            reason = "" if len(snapshot) else why_none_compares(connection, key.parameters, key.version)
        if reason:
            raise UnsuitedError(reason).with_advice(ADVICE)
        try:
            return evaluation_of(snapshot, chosen)
        except UnsuitedError as error:
            total = self._store.load(shape_rows.count_shapes)
            if len(snapshot) == total:
                raise
            compared = f"{len(snapshot)} of {total} shapes have the parameters of the evaluation"
            raise UnsuitedError(f"{error}; {compared}").with_advice(ADVICE) from None

    def map(self, measure: str, parameters: Parameters | None, options: MapOptions) -> ShapeMap:
        """Embed the shapes computed with `parameters` so that similar shapes are near each other (Fig. 8).

        Raises
        ------
        ParameterError
            If there is no such measure, or it does not compare vectors.
        """
        chosen = get_vector_measure(measure)
        with self._store.read() as connection:
            by_measure, in_space = (
                self._index.snapshot(connection, _key(each, parameters)) for each in (chosen, SURFACE_MOMENTS)
            )
            selection = select(connection, by_measure, in_space, options.limit)
            key = _key(chosen, parameters)
            reason = "" if selection.count else why_none_compares(connection, key.parameters, key.version)
        return replace(map_of(selection, chosen, options), warnings=none_compares(reason))


def _key(measure: VectorMeasure, parameters: Parameters | None) -> IndexKey:
    return IndexKey(measure, (parameters or Parameters()).to_json(), ALGORITHM_VERSION)
