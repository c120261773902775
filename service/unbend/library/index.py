"""Search vectors in memory: loaded once, appended to as shapes arrive, true to the store at every query."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field

import numpy as np
from sqlalchemy import Connection, func, select

from unbend.arrays import Singles
from unbend.library.payload import unpack_vector
from unbend.library.schema import descriptors, library_state, shapes, signatures


@dataclass(frozen=True)
class IndexKey:
    """What makes vectors comparable."""

    measure: str
    parameters: str
    version: str


@dataclass(frozen=True)
class IndexedShapes:
    """The shapes of one key in the order they were added."""

    vectors: Singles = field(default_factory=lambda: np.empty((0, 0), np.float32))  # (n, d)
    ids: tuple[str, ...] = ()
    names: tuple[str, ...] = ()
    labels: tuple[str | None, ...] = ()
    revision: int = -1
    last_seq: int = 0


class VectorIndex:
    """Cache of `IndexedShapes` by key; SQLite stays the truth."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._cache: dict[IndexKey, IndexedShapes] = {}

    def get(self, connection: Connection, key: IndexKey) -> IndexedShapes:
        """Return all shapes that `connection` sees under `key`."""
        revision = connection.scalar(select(library_state.c.revision)) or 0
        last = connection.scalar(select(func.max(shapes.c.seq))) or 0
        with self._lock:
            cached = self._cache.get(key, IndexedShapes())
            if cached.revision != revision:
                cached = IndexedShapes(revision=revision)
            if cached.last_seq < last:
                cached = _extended(connection, key, cached, last)
            self._cache[key] = cached
            return cached


def _extended(connection: Connection, key: IndexKey, known: IndexedShapes, last: int) -> IndexedShapes:
    query = (
        select(shapes.c.id, shapes.c.name, shapes.c.label, descriptors.c.vector)
        .select_from(
            shapes.join(signatures, shapes.c.signature_id == signatures.c.id).join(
                descriptors, descriptors.c.signature_id == signatures.c.id
            )
        )
        .where(
            descriptors.c.measure == key.measure,
            signatures.c.parameters == key.parameters,
            signatures.c.version == key.version,
            shapes.c.seq > known.last_seq,
            shapes.c.seq <= last,
        )
        .order_by(shapes.c.seq)
    )
    rows = connection.execute(query).all()
    vectors = known.vectors
    if rows:
        added = np.stack([unpack_vector(row.vector) for row in rows]).astype(np.float32)
        vectors = np.concatenate([vectors, added]) if len(vectors) else added
    return IndexedShapes(
        vectors,
        known.ids + tuple(row.id for row in rows),
        known.names + tuple(row.name for row in rows),
        known.labels + tuple(row.label for row in rows),
        known.revision,
        last,
    )
