"""Rows of vectors for the search by a database: PostgreSQL with the extension pgvector 0.8 or later.

The rows repeat what `descriptors` contains, in the form that the extension searches. So they belong to no migration:
they may be dropped, created and filled at any time. A database without the extension has none of these tables.

A *partition* has the vectors of one measure, parameters and version, which are comparable. A partition with many
vectors has an index of its own (HNSW: Malkov & Yashunin 2018). The index has half precision, which halves its size.
`search/nearest.py` orders its candidates again in single precision.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from sqlalchemy import (
    Boolean,
    Column,
    ColumnElement,
    Connection,
    Engine,
    Float,
    ForeignKey,
    Integer,
    MetaData,
    String,
    Table,
    UniqueConstraint,
    cast,
    column,
    exists,
    func,
    literal_column,
    select,
    table,
    text,
    update,
)
from sqlalchemy.dialects.postgresql import insert
from sqlalchemy.engine import Row
from sqlalchemy.exc import DBAPIError
from sqlalchemy.types import TypeEngine, UserDefinedType

from unbend.arrays import Singles
from unbend.errors import StoreError, VectorsMissingError
from unbend.library.storage.postgres import lock
from unbend.library.storage.schema import descriptors, shapes, signatures
from unbend.matching.measures import VectorMeasure
from unbend.matching.measures.vectors import SPECTRUM

SEARCHED: Final[tuple[VectorMeasure, ...]] = (SPECTRUM,)
"""The measures by which a database searches. Queries by other measures need the index in memory."""

INDEXED_ROWS: Final = 20_000
"""Least number of vectors of a partition for which an index is built: a scan of fewer takes a few milliseconds."""

_LEAST_VERSION: Final = (0, 8)
_BUILD_LOCK: Final = 0x756E62656E65
"""The advisory lock under which indexes are built: of a session, because they are built outside transactions."""
_NO_LIMITS: Final = (("statement_timeout", "0"), ("lock_timeout", "0"))
"""Settings of a build, which takes minutes and waits for older transactions."""
_INDEX_PREFIX: Final = "ix_vectors_embedding_"
_FILLED_AT_A_TIME: Final = 1000
_CONNECTIONS, _CANDIDATES = 16, 64
"""HNSW's m and ef_construction: more took longer to build and found no more (`benchmarks/cluster/search.py`)."""


class _VectorType(UserDefinedType[Any]):
    """A type of pgvector. Its values are sent as text, and received as `vector_send` returns them."""

    cache_ok = True

    def __init__(self, name: str) -> None:
        self.name = name

    def get_col_spec(self, **_options: Any) -> str:
        """Return the name in SQL."""
        return self.name


def vector_type(name: str) -> TypeEngine[Any]:
    """Return a type of pgvector, such as vector or halfvec(120)."""
    return _VectorType(name)


vector_metadata = MetaData()

partitions = Table(
    "vector_partitions",
    vector_metadata,
    Column("id", Integer, primary_key=True),
    Column("measure", String, nullable=False),
    Column("parameters", String, nullable=False),
    Column("version", String, nullable=False),
    Column("dimensions", Integer, nullable=False),
    UniqueConstraint("measure", "parameters", "version"),
    comment="What vectors must share to be comparable.",
)

vectors = Table(
    "vectors",
    vector_metadata,
    Column("seq", ForeignKey(shapes.c.seq, ondelete="CASCADE"), primary_key=True),
    Column("partition_id", ForeignKey(partitions.c.id), primary_key=True),
    Column("embedding", vector_type("vector"), nullable=False),
    comment="The descriptors of shapes for the search by pgvector: `vector_rows.fill` writes them again.",
)

vector_state = Table(
    "vector_state",
    vector_metadata,
    Column("id", Integer, primary_key=True),
    Column("complete", Boolean, nullable=False),
    Column("recall", Float),
    comment="One row: whether every shape has its vectors, so that a search finds all; and the measured recall.",
)

_pg_index = table("pg_index", column("indexrelid"), column("indisvalid"))
_pg_class = table("pg_class", column("oid"), column("reltuples"))

# A JSON document that contains the character zero is no jsonb: such metadata cannot be asked for.
_AS_JSONB = r"CASE WHEN strpos(CAST(metadata AS text), '\u0000') = 0 THEN CAST(metadata AS jsonb) END"


def searched_metadata(table: str) -> ColumnElement[Any]:
    """Return the metadata of a table of shapes in the form that an index finds by containment."""
    return literal_column(f"({_AS_JSONB.replace('metadata', f'{table}.metadata')})")


_METADATA_INDEX: Final = "ix_shapes_metadata_contained"


@dataclass(frozen=True)
class VectorKind:
    """The measure, parameters (as JSON) and version that vectors must share to be comparable."""

    measure: VectorMeasure
    parameters: str
    version: str


@dataclass(frozen=True)
class Partition:
    """The vectors of one kind in a database."""

    id: int
    kind: VectorKind
    dimensions: int
    is_indexed: bool
    indexed_rows: int
    """About how many vectors the index has."""

    @property
    def index(self) -> str:
        """The name of its index; small partitions have none."""
        return f"{_INDEX_PREFIX}{self.id}"

    @property
    def own(self) -> ColumnElement[bool]:
        """Whether a row belongs to this partition, in the form that the index expects."""
        return vectors.c.partition_id == literal_column(str(self.id))

    @property
    def halves(self) -> ColumnElement[Any]:
        """The vectors in half precision, in the form that the index expects."""
        return cast(vectors.c.embedding, vector_type(f"halfvec({self.dimensions})"))


def as_text(vector: Singles) -> str:
    """Return a vector in the form that pgvector reads, without loss."""
    return f"[{','.join(map(str, vector.tolist()))}]"


def from_bytes(sent: Sequence[bytes], dimensions: int) -> Singles:
    """Return the vectors, (n, dimensions), that `vector_send` wrote: two numbers of 16 bits, and big-endian singles."""
    packed = np.frombuffer(b"".join(sent), np.uint8).reshape(len(sent), 4 + 4 * dimensions)
    return np.ascontiguousarray(packed[:, 4:]).view(">f4").astype(np.float32)


def create_vectors(connection: Connection) -> None:
    """Create the extension, and its tables, unless they exist; wait for running writers of shapes.

    Raises
    ------
    VectorsMissingError
        If the server has no pgvector, has an old one, or the role may not create extensions.
    """
    lock(connection, "vectors")
    _create_extension(connection)
    if has_vectors(connection):
        return
    # Whoever adds a shape after this lock sees the tables, and adds its vectors; `fill` adds those of earlier shapes.
    connection.execute(text("LOCK TABLE shapes IN SHARE ROW EXCLUSIVE MODE"))
    vector_metadata.create_all(connection)
    connection.execute(insert(vector_state).values(id=1, complete=False))


def drop_vectors(connection: Connection) -> None:
    """Drop the tables if they exist; the extension stays."""
    connection.execute(text(f"DROP INDEX IF EXISTS {_METADATA_INDEX}"))
    vector_metadata.drop_all(connection)


def has_vectors(connection: Connection) -> bool:
    """Return whether the database has the tables: never, unless it is PostgreSQL."""
    if connection.dialect.name != "postgresql":
        return False
    return connection.scalar(select(func.to_regclass(vectors.name))) is not None


def find_partition(connection: Connection, kind: VectorKind) -> Partition | None:
    """Return the partition of a kind; None if the database cannot search it, or does not have all its vectors yet."""
    if kind.measure not in SEARCHED or not has_vectors(connection):
        return None
    return _find(connection, kind, is_complete=True)


def set_recall(connection: Connection, recall: float) -> None:
    """Store the measured recall of the search."""
    connection.execute(update(vector_state).values(recall=recall))


def get_recall(connection: Connection) -> float | None:
    """Return the recall that was measured last; None if none was."""
    return connection.scalar(select(vector_state.c.recall)) if has_vectors(connection) else None


def add_vectors(
    connection: Connection, seq: int, parameters: str, version: str, stored: Mapping[str, bytes | memoryview]
) -> None:
    """Add the vectors of a new shape, in the transaction that adds it; do nothing if the database has no vectors.

    Removing the shape removes them. Its name, label and metadata are not in them, so changes of those do not matter.

    Parameters
    ----------
    connection : Connection
    seq : int
        The shape's place in the order of adding.
    parameters, version : str
        Those of its signature.
    stored : mapping
        Its descriptors by name, as `packing.pack_vector` returns them.

    Raises
    ------
    StoreError
        If other vectors of its kind have another number of dimensions.
    """
    if has_vectors(connection):
        _add(connection, [_Stored(seq, parameters, version, stored)])


def fill(engine: Engine) -> int:
    """Add the vectors of shapes that have none, in several transactions; return how many shapes.

    Searches by the database begin when all are added. May run in several processes at a time.
    """
    added, after = 0, 0
    while True:
        with engine.begin() as connection:
            found = _without_vectors(connection, after)
            if not found:
                connection.execute(update(vector_state).values(complete=True))
                return added
            _add(connection, found)
        added, after = added + len(found), found[-1].seq


def build_indexes(engine: Engine, *, least: int = INDEXED_ROWS, memory_mb: int = 1024) -> int:
    """Build the missing indexes, of metadata and of large partitions, while others read and write; return how many.

    Call this outside any transaction. If another process builds indexes, this returns at once.

    Parameters
    ----------
    engine : Engine
    least : int, default INDEXED_ROWS
        Number of vectors from which a partition is large.
    memory_mb : int, default 1024
        Memory that the database may use. A build slows down when the index of a partition no longer fits.
    """
    with engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
        if not connection.scalar(select(func.pg_try_advisory_lock(_BUILD_LOCK))):
            return 0
        try:
            for name, value in (("maintenance_work_mem", f"{memory_mb}MB"), *_NO_LIMITS):
                connection.execute(select(func.set_config(name, value, False)))
            wanted = {_METADATA_INDEX: f"shapes USING gin (({_AS_JSONB}) jsonb_path_ops)"}
            wanted |= {
                each.index: _hnsw(each) for each in _list_partitions(connection) if _has(connection, each, least)
            }
            missing = [name for name in wanted if not _is_valid(connection, name)]
            for name in missing:
                # A build that was interrupted leaves an index that is not valid.
                connection.execute(text(f"DROP INDEX CONCURRENTLY IF EXISTS {name}"))
                connection.execute(text(f"CREATE INDEX CONCURRENTLY {name} ON {wanted[name]}"))
            return len(missing)
        finally:
            for name in ("maintenance_work_mem", *dict(_NO_LIMITS)):
                connection.execute(text(f"RESET {name}"))
            connection.execute(select(func.pg_advisory_unlock(_BUILD_LOCK)))


def _hnsw(partition: Partition) -> str:
    return (
        f"{vectors.name} USING hnsw (CAST(embedding AS halfvec({partition.dimensions})) halfvec_l1_ops)"
        f" WITH (m = {_CONNECTIONS}, ef_construction = {_CANDIDATES}) WHERE partition_id = {partition.id}"
    )


def _is_valid(connection: Connection, index: str) -> bool:
    valid = select(_pg_index.c.indisvalid).where(_pg_index.c.indexrelid == func.to_regclass(index))
    return bool(connection.scalar(valid))


def _has(connection: Connection, partition: Partition, least: int) -> bool:
    """Return whether a partition has at least so many vectors; the count ends there."""
    some = select(vectors.c.seq).where(partition.own).limit(least).subquery()
    return (connection.scalar(select(func.count()).select_from(some)) or 0) >= least


@dataclass(frozen=True)
class _Stored:
    """A shape, and descriptors that it has in the store."""

    seq: int
    parameters: str
    version: str
    descriptors: Mapping[str, bytes | memoryview]


def _without_vectors(connection: Connection, after: int) -> list[_Stored]:
    """Return some shapes without vectors, which nobody removes before the end of the transaction."""
    chosen = (
        select(shapes.c.seq, shapes.c.signature_id, signatures.c.parameters, signatures.c.version)
        .join(signatures, shapes.c.signature_id == signatures.c.id)
        .where(shapes.c.seq > after, ~exists().where(vectors.c.seq == shapes.c.seq))
        .order_by(shapes.c.seq)
        .limit(_FILLED_AT_A_TIME)
        .with_for_update(read=True, key_share=True, of=shapes)
    )
    found = connection.execute(chosen).all()
    names = {name for measure in SEARCHED for name, _ in measure.parts}
    wanted = select(descriptors.c.signature_id, descriptors.c.measure, descriptors.c.vector).where(
        descriptors.c.signature_id.in_([row.signature_id for row in found]), descriptors.c.measure.in_(names)
    )
    parts: defaultdict[int, dict[str, bytes]] = defaultdict(dict)
    for row in connection.execute(wanted):
        parts[row.signature_id][row.measure] = row.vector
    return [_Stored(row.seq, row.parameters, row.version, parts[row.signature_id]) for row in found]


def _add(connection: Connection, stored: Sequence[_Stored]) -> None:
    rows: list[dict[str, Any]] = []
    known: dict[VectorKind, Partition] = {}
    for shape in stored:
        for measure in SEARCHED:
            if not all(name in shape.descriptors for name, _ in measure.parts):
                continue
            vector = measure.vector({name: np.frombuffer(each, "<f8") for name, each in shape.descriptors.items()})
            kind = VectorKind(measure, shape.parameters, shape.version)
            if kind not in known:
                known[kind] = _find_or_add(connection, kind, len(vector))
            if len(vector) != known[kind].dimensions:
                expected = known[kind].dimensions
                raise StoreError(f"a stored descriptor has {len(vector)} numbers where others have {expected}")
            if np.isfinite(vector).all():  # no search returns others
                rows.append({"seq": shape.seq, "partition_id": known[kind].id, "embedding": as_text(vector)})
    if rows:
        connection.execute(insert(vectors).on_conflict_do_nothing(), rows)


def _find_or_add(connection: Connection, kind: VectorKind, dimensions: int) -> Partition:
    found = _find(connection, kind)
    if found is None:
        values = {"measure": kind.measure.name, "parameters": kind.parameters, "version": kind.version}
        connection.execute(insert(partitions).values(**values, dimensions=dimensions).on_conflict_do_nothing())
        found = _find(connection, kind)
    if found is None:
        raise StoreError("another transaction has just added the same kind of vectors")
    return found


_INDEX = func.to_regclass(func.concat(_INDEX_PREFIX, partitions.c.id))
_PARTITIONS = select(partitions, _pg_index.c.indisvalid, _pg_class.c.reltuples).select_from(
    partitions.outerjoin(_pg_index, _pg_index.c.indexrelid == _INDEX).outerjoin(_pg_class, _pg_class.c.oid == _INDEX)
)


def _find(connection: Connection, kind: VectorKind, *, is_complete: bool | None = None) -> Partition | None:
    query = _PARTITIONS.where(
        partitions.c.measure == kind.measure.name,
        partitions.c.parameters == kind.parameters,
        partitions.c.version == kind.version,
    )
    if is_complete is not None:
        query = query.where(exists().where(vector_state.c.complete == is_complete))
    row = connection.execute(query).one_or_none()
    return None if row is None else _partition(row, kind)


def _partition(row: Row[*tuple[Any, ...]], kind: VectorKind) -> Partition:
    return Partition(row.id, kind, row.dimensions, bool(row.indisvalid), max(0, int(row.reltuples or 0)))


def _list_partitions(connection: Connection) -> list[Partition]:
    return [
        _partition(row, VectorKind(measure, row.parameters, row.version))
        for row in connection.execute(_PARTITIONS.order_by(partitions.c.id))
        for measure in SEARCHED
        if measure.name == row.measure
    ]


def _create_extension(connection: Connection) -> None:
    installed = connection.scalar(text("SELECT extversion FROM pg_extension WHERE extname = 'vector'"))
    if installed is None:
        try:
            with connection.begin_nested():
                connection.execute(text("CREATE EXTENSION vector"))
        except DBAPIError as error:
            raise VectorsMissingError(
                "the database has no extension pgvector, and this role cannot create it"
            ) from error
        installed = connection.scalar(text("SELECT extversion FROM pg_extension WHERE extname = 'vector'"))
    if tuple(map(int, str(installed).split(".")[:2])) < _LEAST_VERSION:
        raise VectorsMissingError(f"the database has pgvector {installed}, and unbend needs 0.8 or later")
