"""Nearest shapes by a database that has vectors (`vector_rows`): exactly, or by an approximate index.

The index yields candidates in half precision. They are ordered again here, by the same single-precision distances as
those of the index in memory, so both answers differ only where the database's index misses a shape.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, Final, Literal

import numpy as np
from sqlalchemy import (
    BindParameter,
    ColumnElement,
    Connection,
    Integer,
    LargeBinary,
    Select,
    String,
    any_,
    bindparam,
    cast,
    func,
    literal_column,
    select,
    tablesample,
)
from sqlalchemy.dialects.postgresql import ARRAY, JSONB
from sqlalchemy.engine import Row

from unbend.arrays import Floats, Indices, Singles
from unbend.errors import ParameterError, VectorsMissingError
from unbend.library.storage.schema import shapes
from unbend.library.vector_rows import (
    Partition,
    VectorKind,
    as_text,
    find_partition,
    from_bytes,
    has_vectors,
    searched_metadata,
    vector_type,
    vectors,
)

MOST: Final = 1000
"""Largest number of shapes that the index is asked for, as pgvector limits its list of candidates."""

_LEAST: Final = 100
"""Least number of candidates that are ordered again: half precision exchanges two or three in a hundred of the ten."""

_FILTERED_SHARE: Final = 3
"""With a filter, the index compares many shapes for each candidate: so many candidates for each shape asked for."""

_FEW: Final = 10
"""See `_Search.if_few`: chosen by the table "Filters" of `benchmarks/cluster/search.py`."""

_SAMPLED: Final = 1000
"""About how many shapes a sample has (see `_Search._keeps_many`)."""

_KEPT: Final = ("kept",)
"""Instead of the names of conditions: the shapes that a filter keeps are known."""

_MARGIN: Final = 10
"""More rows than asked for are read, because the database rounds sums in another order."""


SearchChoice = Literal["auto", "memory", "database"]
"""The searcher: the index in memory, the database, or by default the index in memory until it becomes too large."""

AUTO_ROWS: Final = 500_000
"""Number of vectors from which the database searches by default: in memory they take 250 MB in each process."""


def choose_partition(connection: Connection, kind: VectorKind, choice: SearchChoice) -> Partition | None:
    """Return the partition that answers queries of a kind; None if the index in memory answers them.

    The index in memory also answers what the database cannot: measures other than `vector_rows.SEARCHED`, and queries
    before all shapes have vectors.

    Raises
    ------
    VectorsMissingError
        If the database shall search, and has no vectors.
    """
    if choice == "memory":
        return None
    if choice == "database" and not has_vectors(connection):
        raise VectorsMissingError("the database of the library has no vectors to search")
    partition = find_partition(connection, kind)
    if choice == "auto" and partition and not (partition.is_indexed and partition.indexed_rows >= AUTO_ROWS):
        return None
    return partition


@dataclass(frozen=True)
class Filter:
    """Conditions on shapes."""

    label: str | None = None
    """Only shapes of this class, if given."""
    metadata: Mapping[str, Any] = field(default_factory=dict)
    """Members that the metadata must contain, with these values."""
    is_labelled: bool = False
    """Only shapes that have a class."""

    def __bool__(self) -> bool:
        return bool(self.given)

    @property
    def given(self) -> tuple[str, ...]:
        """The names of the fields that are conditions."""
        return tuple(name for name, value in vars(self).items() if value not in (None, {}, False))


EVERY: Final = Filter()

_CONTAINED: Final = bindparam("metadata", type_=JSONB())

CONDITIONS: Final[Mapping[str, ColumnElement[bool]]] = {
    "label": shapes.c.label == bindparam("label", type_=String()),
    "metadata": searched_metadata(shapes.name).op("@>", is_comparison=True)(_CONTAINED),
    "is_labelled": shapes.c.label.is_not(None),
}
"""The fields of `Filter` in SQL."""


def values_of(only: Filter) -> dict[str, Any]:
    """Return the values of CONDITIONS."""
    return {"label": only.label, "metadata": dict(only.metadata)}


@dataclass(frozen=True, eq=False)
class Nearest:
    """The shapes nearest to a query, nearest first; those at one distance are in the order of adding."""

    seqs: Indices
    """Their places in the order of adding, (n,)."""
    labels: tuple[str | None, ...]
    distances: Floats
    """(n,)."""
    vectors: Singles
    """(n, d)."""
    is_exact: bool
    """Whether every shape was compared, so that no nearer one is missing."""


def find_nearest(
    connection: Connection,
    partition: Partition,
    query: Singles,
    count: int,
    only: Filter = EVERY,
    *,
    without: int = 0,
    exact: bool = False,
) -> Nearest:
    """Return the shapes nearest to a query.

    Parameters
    ----------
    connection : Connection
        In a transaction, whose settings of the search this changes.
    partition : Partition
    query : (d,) float32
    count : int
        At least 1.
    only : Filter, optional
    without : int, default 0
        A shape that is left out, by its place in the order of adding: the query itself if it is stored.
    exact : bool, default False
        Compare every shape. This is also done if there is no index, if the filter keeps few shapes, or if the index
        does not find enough.

    Raises
    ------
    ParameterError
        If the query has another number of dimensions than the partition, or is not finite.
    """
    if not np.isfinite(query).all():
        raise ParameterError("the query contains a value that is not finite")
    if query.shape != (partition.dimensions,):
        raise ParameterError(f"a query of shape {query.shape} does not match {partition.dimensions} dimensions")
    search = _Search(connection, partition, query, count, only, without)
    if exact or not partition.is_indexed or count > MOST:
        return search.exactly(only.given)
    found = (search.if_few() if only else None) or search.by_index()
    return search.exactly(only.given) if found is None else found


@dataclass(frozen=True)
class _Search:
    """A call of `find_nearest`."""

    connection: Connection
    partition: Partition
    query: Singles
    count: int
    only: Filter
    without: int

    def exactly(self, given: tuple[str, ...], kept: Sequence[int] = ()) -> Nearest:
        """Compare every shape that the conditions keep, or every one of those `kept`."""
        return self._ordered(self._rows(given, self.count + _MARGIN, kept, is_exact=True), is_exact=True)

    def if_few(self) -> Nearest | None:
        """Compare every shape that the filter keeps, if they are so few that it is quicker than the index.

        The index is asked for a fixed number of shapes that the filter keeps. If the filter keeps k of n shapes, the
        index compares about n / k times as many, and the exact way compares k. So both are equally quick where k is
        proportional to the square root of n. The search for the k shapes ends there.
        """
        most = int(_FEW * self.partition.indexed_rows**0.5)
        of_labels = [CONDITIONS[name] for name in self.only.given if name != "metadata"]
        if of_labels:  # which an index counts quickly
            some = select(shapes.c.seq).where(*of_labels).limit(most + 1).subquery()
            count = self.connection.scalar(select(func.count()).select_from(some), values_of(self.only)) or 0
            if count <= most:
                return self.exactly(self.only.given)
        if not self.only.metadata or self._keeps_many(most):
            return None
        found = select(shapes.c.seq).where(*(CONDITIONS[name] for name in self.only.given)).limit(most + 1)
        kept = self.connection.scalars(found, values_of(self.only)).all()  # which parses the metadata, and only once
        return self.exactly(_KEPT, kept) if len(kept) <= most else None

    def _keeps_many(self, most: int) -> bool:
        """Return whether the metadata of a sample of the shapes show that far more than `most` are kept.

        This saves time: to find that out exactly, the metadata of `most` shapes must be parsed.
        """
        n = self.partition.indexed_rows
        percent = min(100.0, 100 * _SAMPLED / max(1, n))
        sample = tablesample(shapes, func.system(percent), name="sampled")
        is_kept = searched_metadata("sampled").op("@>", is_comparison=True)(_CONTAINED)
        looked = select(func.count(sample.c.seq), func.count().filter(is_kept))
        total, kept = self.connection.execute(looked, values_of(self.only)).one()
        return bool(total >= _SAMPLED / 2 and kept * n > 2 * most * total)

    def by_index(self) -> Nearest | None:
        """Compare candidates; None if the index ended before it found enough of the shapes that the filter keeps.

        It ends after 20,000 candidates, for example if the filter keeps only a class that is far from the query.
        """
        wanted = min(_FILTERED_SHARE * self.count, MOST) if self.only else max(self.count, _LEAST)
        _set(self.connection, ef_search=max(wanted, _LEAST))
        rows = self._rows(self.only.given, wanted, (), is_exact=False)
        return None if self.only and len(rows) < wanted else self._ordered(rows, is_exact=False)

    def _rows(
        self, given: tuple[str, ...], wanted: int, kept: Sequence[int], *, is_exact: bool
    ) -> Sequence[Row[*tuple[Any, ...]]]:
        values = {"query": as_text(self.query), "without": self.without, "kept": kept, **values_of(self.only)}
        return self.connection.execute(_statement(self.partition, given, is_exact, wanted), values).all()

    def _ordered(self, rows: Sequence[Row[*tuple[Any, ...]]], *, is_exact: bool) -> Nearest:
        dimensions = self.partition.dimensions
        if not rows:
            nothing = np.empty((0, dimensions), np.float32)
            return Nearest(np.empty(0, np.int64), (), np.empty(0), nothing, is_exact)
        places, labels, sent = zip(*rows, strict=True)
        seqs, found = np.array(places), from_bytes(sent, dimensions)
        distances = self.partition.kind.measure.distances(self.query, found)
        order = np.lexsort((seqs, distances))[: self.count]
        return Nearest(seqs[order], tuple(labels[row] for row in order), distances[order], found[order], is_exact)


@lru_cache(maxsize=256)
def _statement(partition: Partition, given: tuple[str, ...], is_exact: bool, wanted: int) -> Select[*tuple[Any, ...]]:
    """Build the statement that reads seqs, labels and vectors: building it costs more than running it.

    The limit is part of the text, because a plan for any limit would not use the index.
    """
    sent: BindParameter[str] = bindparam("query")
    order: ColumnElement[Any] = (
        vectors.c.embedding.op("<+>")(cast(sent, vector_type("vector")))
        if is_exact
        else partition.halves.op("<+>")(cast(sent, vector_type(f"halfvec({partition.dimensions})")))
    )
    chosen = select(vectors.c.seq, vectors.c.embedding).where(partition.own, vectors.c.seq != bindparam("without"))
    if given == _KEPT:
        chosen = chosen.where(vectors.c.seq == any_(bindparam("kept", type_=ARRAY(Integer))))
    elif given:
        chosen = chosen.join(shapes, shapes.c.seq == vectors.c.seq).where(*(CONDITIONS[name] for name in given))
    nearest = chosen.order_by(order).limit(literal_column(str(wanted))).subquery("nearest")
    # A subquery finds each label by the key. For a join, the planner may read all shapes.
    label = select(shapes.c.label).where(shapes.c.seq == nearest.c.seq).scalar_subquery().label("label")
    return select(nearest.c.seq, label, func.vector_send(nearest.c.embedding, type_=LargeBinary))


def _set(connection: Connection, ef_search: int) -> None:
    """Set the number of candidates of this transaction's searches, and let filters ask for more."""
    settings = {"hnsw.ef_search": str(ef_search), "hnsw.iterative_scan": "relaxed_order"}
    connection.execute(select(*(func.set_config(name, value, True) for name, value in settings.items())))
