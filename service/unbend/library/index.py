"""Search vectors in memory: loaded once, appended to as shapes arrive, true to the store at every query."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from sqlalchemy import Connection, FromClause, Select, and_, bindparam, func, select

from unbend.arrays import Singles
from unbend.errors import StoreError
from unbend.library.schema import descriptors, library_state, removals, shapes, signatures
from unbend.library.table import Held, Table
from unbend.matching.measures import VectorMeasure

_MOST_TABLES: Final = 32
"""Kept in memory: those that were asked for last."""

_CHUNK: Final = 256
"""Rows that are read from the store at a time: few, so that they are still in the cache when they are put together."""

_STATE = select(
    library_state.c.epoch, library_state.c.revision, select(func.max(shapes.c.seq)).scalar_subquery().label("last")
)
_CHANGED = select(shapes.c.seq, shapes.c.label).where(shapes.c.changed > bindparam("revision"))
_REMOVED = select(removals.c.seq).where(removals.c.revision > bindparam("revision"))


@dataclass(frozen=True)
class IndexKey:
    """What makes vectors comparable."""

    measure: VectorMeasure
    parameters: str
    version: str


class VectorIndex:
    """Tables of vectors by key; the store stays the truth. Thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._tables: OrderedDict[IndexKey, _StoredTable] = OrderedDict()

    def __len__(self) -> int:
        """Return how many tables are kept."""
        return len(self._tables)

    def get(self, connection: Connection, key: IndexKey) -> Held:
        """Return all shapes that `connection` sees under `key`.

        Its transaction should begin with this call: then it sees no less than others have brought here.

        Raises
        ------
        StoreError
            If what is stored does not fit together.
        """
        with self._lock:
            table = self._tables.get(key) or _StoredTable(key)
            self._tables[key] = table
            self._tables.move_to_end(key)
            while len(self._tables) > _MOST_TABLES:
                self._tables.popitem(last=False)
        held = table.at(connection)
        if not len(held.seqs):  # anybody may ask for parameters that no shape has
            with self._lock:
                self._tables.pop(key, None)
        return held


class _StoredTable:
    """A table, and the epoch and revision of the store it is true to.

    Whoever asks while it is read waits, and reads nothing.
    """

    def __init__(self, key: IndexKey) -> None:
        self._lock = threading.Lock()
        self._weights = [weight for _, weight in key.measure.parts]
        self._added = _select_added(key)
        self._begin_anew("")

    def _begin_anew(self, epoch: str) -> None:
        self._table = Table()
        self._held = self._table.held()
        self._epoch = epoch
        self._revision = -1
        self._last_seq = 0

    def at(self, connection: Connection) -> Held:
        with self._lock:
            epoch, revision, last = connection.execute(_STATE).one()
            if epoch != self._epoch or revision < self._revision:  # another store was put into the place of this one
                self._begin_anew(epoch)
            if revision != self._revision:
                self._catch_up(connection, last or 0)
                self._held = self._table.held()
                self._revision = revision
            return self._held

    def _catch_up(self, connection: Connection, last: int) -> None:
        if len(self._table):
            since = {"revision": self._revision}
            changed = connection.execute(_CHANGED, since).all()
            self._table.relabel([row.seq for row in changed], [row.label for row in changed])
            self._table.remove(connection.scalars(_REMOVED, since).all())
        added = connection.execute(
            self._added, {"after": self._last_seq, "last": last}, execution_options={"yield_per": _CHUNK}
        )
        for rows in added.partitions():
            seqs, labels, *parts = zip(*rows, strict=True)
            self._table.append(seqs, labels, _vectors(parts, self._weights))
            self._last_seq = seqs[-1]
        self._last_seq = max(self._last_seq, last)


def _select_added(key: IndexKey) -> Select[*tuple[Any, ...]]:
    """Make the statement that reads seqs, labels and each of a measure's descriptors, in the order of adding."""
    joined: FromClause = shapes.join(signatures, shapes.c.signature_id == signatures.c.id)
    columns: list[Any] = [shapes.c.seq, shapes.c.label]
    for name, _ in key.measure.parts:
        part = descriptors.alias()
        joined = joined.join(part, and_(part.c.signature_id == signatures.c.id, part.c.measure == name))
        columns.append(part.c.vector)
    return (
        select(*columns)
        .select_from(joined)
        .where(
            shapes.c.seq > bindparam("after"),
            shapes.c.seq <= bindparam("last"),
            signatures.c.parameters == key.parameters,
            signatures.c.version == key.version,
        )
        .order_by(shapes.c.seq)
    )


def _vectors(parts: Sequence[Sequence[bytes]], weights: Sequence[float]) -> Singles:
    """Return what `VectorMeasure.vector` makes of each row's descriptors, (n, d)."""
    blocks = []
    for part, weight in zip(parts, weights, strict=True):
        if len(set(map(len, part))) > 1:
            raise StoreError("stored descriptors of one kind are of different lengths")
        block = np.frombuffer(b"".join(part), "<f8").reshape(len(part), -1)
        blocks.append((weight * block).astype(np.float32))
    return np.concatenate(blocks, axis=1)
