"""Search in a library: rankings of queries, evaluation, and the class map."""

from __future__ import annotations

from dataclasses import replace

from unbend.errors import UnsuitedError
from unbend.library import shape_rows
from unbend.library.requests import QueryRequest
from unbend.library.search.incomparable import ADVICE, none_compares, why_none_compares
from unbend.library.search.index import IndexKey, SearchIndex
from unbend.library.search.overview import MapOptions, evaluation_of, map_of, select
from unbend.library.search.parts import PartIndex, rank_parts
from unbend.library.search.ranking import rank
from unbend.library.storage.store import Store
from unbend.matching.measures import VectorMeasure, get_vector_measure
from unbend.matching.measures.vectors import SURFACE_MOMENTS
from unbend.results.evaluations import EvaluationResult
from unbend.results.maps import ShapeMap
from unbend.results.rankings import Ranking
from unbend.signature.parameters import Parameters
from unbend.signature.signature import ALGORITHM_VERSION, Signature

__all__ = ["MapOptions", "Search"]


class Search:
    """Search among the shapes of a store, with an index in memory; thread-safe."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._index = SearchIndex()
        self._parts = PartIndex()

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
        return rank(self._store, self._index, query, request)

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
