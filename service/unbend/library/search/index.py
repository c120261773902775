"""The search index: vectors of all shapes in memory, loaded once and updated from the store at every query."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Connection, FromClause, Select, and_, bindparam, func, select

from unbend.arrays import Bools, Codes, Floats, Indices, Singles
from unbend.errors import StoreError
from unbend.library.storage.schema import descriptors, library_state, removals, shapes, signatures
from unbend.matching.gallery import UNLABELLED, Gallery
from unbend.matching.measures import VectorMeasure

_MAX_PARTITIONS: Final = 32
"""Partitions kept in memory; the least recently used is evicted."""

_CHUNK: Final = 256
"""Rows that are read from the store at a time: few enough to stay in the CPU cache until they are concatenated."""

_COMPACT_SHARE: Final = 4
"""A table drops the rows of removed shapes once they are more than one row in four."""

_STATE = select(
    library_state.c.epoch, library_state.c.revision, select(func.max(shapes.c.seq)).scalar_subquery().label("last")
)
_CHANGED = select(shapes.c.seq, shapes.c.label).where(shapes.c.changed > bindparam("revision"))
_REMOVED = select(removals.c.seq).where(removals.c.revision > bindparam("revision"))


@dataclass(frozen=True)
class IndexKey:
    """The properties that two vectors must share to be comparable."""

    measure: VectorMeasure
    parameters: str
    version: str


@dataclass(frozen=True)
class Snapshot:
    """The content of a partition at one moment. It stays unchanged while the partition grows."""

    gallery: Gallery
    seqs: Indices
    """Each row's shape, by its place in the order of adding, (n,); ascending."""
    excluded: Indices
    """Rows that no search returns, (r,); ascending. Rows of removed shapes have no class."""

    def __len__(self) -> int:
        return len(self.seqs) - len(self.excluded)

    def row(self, seq: int) -> int | None:
        """Return the row of a shape; None if the snapshot does not contain the shape."""
        row = int(np.searchsorted(self.seqs, seq))
        found = row < len(self.seqs) and self.seqs[row] == seq and row not in self.excluded
        return row if found else None

    def without(self, row: int) -> Self:
        """Return a snapshot that excludes one more row."""
        return replace(self, excluded=np.union1d(self.excluded, row))

    def only(self, seqs: Collection[int]) -> Self:
        """Return a snapshot of the shapes at these places in the order of adding."""
        kept = np.isin(self.seqs, np.fromiter(seqs, np.int64, len(seqs)))
        kept[self.excluded] = False
        gallery = self.gallery
        return replace(
            self,
            gallery=Gallery(gallery.vectors[kept], gallery.codes[kept], gallery.labels),
            seqs=self.seqs[kept],
            excluded=np.empty(0, np.int64),
        )

    def distances(self, query: Singles, measure: VectorMeasure) -> Floats:
        """Return the distance from `query` (d,) to each row, (n,); infinite for excluded rows."""
        distances = measure.distances(query, self.gallery.vectors)
        distances[self.excluded] = np.inf
        return distances


class SearchIndex:
    """Partitions of comparable vectors, by key. The store remains the source of truth. Thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._partitions: OrderedDict[IndexKey, _Partition] = OrderedDict()

    def __len__(self) -> int:
        """Return the number of partitions in memory."""
        return len(self._partitions)

    def snapshot(self, connection: Connection, key: IndexKey) -> Snapshot:
        """Return all shapes that `connection` sees under `key`.

        The transaction of `connection` should begin with this call: it then sees at least what the index contains.

        Raises
        ------
        StoreError
            If the stored vectors are inconsistent.
        """
        with self._lock:
            partition = self._partitions.get(key) or _Partition(key)
            self._partitions[key] = partition
            self._partitions.move_to_end(key)
            while len(self._partitions) > _MAX_PARTITIONS:
                self._partitions.popitem(last=False)
        snapshot = partition.snapshot(connection)
        if not len(snapshot.seqs):  # callers may send parameters that no shape has: do not keep their partitions
            with self._lock:
                self._partitions.pop(key, None)
        return snapshot


class _Partition:
    """The vectors of one key, and the epoch and revision of the store that they match.

    Callers that arrive during an update wait for it, and then do not read the store's vectors again.
    """

    def __init__(self, key: IndexKey) -> None:
        self._lock = threading.Lock()
        self._weights = [weight for _, weight in key.measure.parts]
        self._added = _select_added(key)
        self._reset("")

    def _reset(self, epoch: str) -> None:
        self._table = VectorTable()
        self._snapshot = self._table.snapshot()
        self._epoch = epoch
        self._revision = -1
        self._last_seq = 0

    def snapshot(self, connection: Connection) -> Snapshot:
        with self._lock:
            epoch, revision, last = connection.execute(_STATE).one()
            if epoch != self._epoch or revision < self._revision:  # a restore replaced the store
                self._reset(epoch)
            if revision != self._revision:
                self._update(connection, last or 0)
                self._snapshot = self._table.snapshot()
                self._revision = revision
            return self._snapshot

    def _update(self, connection: Connection, last: int) -> None:
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


class VectorTable:
    """Vectors, classes and seqs of shapes in the order of adding, in arrays that grow. Not thread-safe.

    Snapshots never change: new rows are written after the rows of earlier snapshots, into arrays that double when
    they are full, and new classes of old rows are written into a copy. Adding a shape to a table of a million therefore
    costs as little as adding it to a table of ten.
    """

    def __init__(self) -> None:
        self._count = 0
        self._vectors: Singles = np.empty((0, 0), np.float32)
        self._codes: Codes = np.empty(0, np.int32)
        self._seqs: Indices = np.empty(0, np.int64)
        self._removed: Indices = np.empty(0, np.int64)
        self._code_of: dict[str | None, int] = {None: UNLABELLED}
        self._labels: tuple[str, ...] = ()

    def __len__(self) -> int:
        return self._count

    def snapshot(self) -> Snapshot:
        """Return the present content."""
        gallery = Gallery(_read_only(self._vectors, self._count), _read_only(self._codes, self._count), self._labels)
        return Snapshot(gallery, _read_only(self._seqs, self._count), self._removed)

    def append(self, seqs: Sequence[int], labels: Sequence[str | None], vectors: Singles) -> None:
        """Append rows whose `seqs` are larger than all earlier ones.

        Raises
        ------
        StoreError
            If `vectors` (n, d) differ in length from the earlier ones.
        """
        self._reserve(*vectors.shape)
        end = self._count + len(vectors)
        new = slice(self._count, end)
        self._vectors[new], self._codes[new], self._seqs[new] = vectors, self._as_codes(labels), seqs
        self._count = end

    def relabel(self, seqs: Sequence[int], labels: Sequence[str | None]) -> None:
        """Set the classes of some shapes; shapes that are not in the table are ignored."""
        rows, found = self._find(seqs)
        self._set_codes(
            rows, self._as_codes([label for label, is_found in zip(labels, found, strict=True) if is_found])
        )

    def remove(self, seqs: Sequence[int]) -> None:
        """Exclude some shapes; shapes that are not in the table are ignored."""
        rows, _ = self._find(seqs)
        self._set_codes(rows, UNLABELLED)
        self._removed = np.union1d(self._removed, rows)
        if len(self._removed) * _COMPACT_SHARE > self._count:
            self._compact()

    def _find(self, seqs: Sequence[int]) -> tuple[Indices, Bools]:
        """Return the rows of the shapes that are in the table, and a mask of these shapes over `seqs`."""
        wanted, known = np.asarray(seqs, np.int64), self._seqs[: self._count]
        rows = np.searchsorted(known, wanted)
        found = rows < self._count
        found[found] = known[rows[found]] == wanted[found]
        return rows[found], found

    def _as_codes(self, labels: Sequence[str | None]) -> Codes:
        for label in dict.fromkeys(labels):
            if label is not None and label not in self._code_of:
                self._code_of[label] = len(self._labels)
                self._labels += (label,)
        return np.array([self._code_of[label] for label in labels], np.int32)

    def _set_codes(self, rows: Indices, codes: Codes | int) -> None:
        if len(rows):
            self._codes = _resized(self._codes, self._count, len(self._codes))
            self._codes[rows] = codes

    def _reserve(self, rows: int, width: int) -> None:
        if not self._count:
            self._vectors = np.empty((0, width), np.float32)
        if width != self._vectors.shape[1]:
            raise StoreError(f"a stored descriptor has {width} numbers where others have {self._vectors.shape[1]}")
        needed = self._count + rows
        if needed > len(self._seqs):
            size = max(needed, 2 * len(self._seqs))
            self._vectors = _resized(self._vectors, self._count, size)
            self._codes = _resized(self._codes, self._count, size)
            self._seqs = _resized(self._seqs, self._count, size)

    def _compact(self) -> None:
        kept = np.ones(self._count, bool)
        kept[self._removed] = False
        self._vectors = self._vectors[: self._count][kept]
        self._codes = self._codes[: self._count][kept]
        self._seqs = self._seqs[: self._count][kept]
        self._count = len(self._seqs)
        self._removed = np.empty(0, np.int64)


def _resized(array: NDArray[Any], count: int, size: int) -> NDArray[Any]:
    """Return a copy of the first `count` rows with capacity for `size` rows; unwritten pages take no memory."""
    result = np.empty((size, *array.shape[1:]), array.dtype)
    result[:count] = array[:count]
    return result


def _read_only(array: NDArray[Any], count: int) -> NDArray[Any]:
    view = array[:count]
    view.flags.writeable = False
    return view


def _select_added(key: IndexKey) -> Select[*tuple[Any, ...]]:
    """Build the statement that reads seqs, labels and each descriptor of a measure, in the order of adding."""
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
    """Return `VectorMeasure.vector` of each row's descriptors, (n, d)."""
    blocks = []
    for part, weight in zip(parts, weights, strict=True):
        if len(set(map(len, part))) > 1:
            raise StoreError("stored descriptors of one kind are of different lengths")
        block = np.frombuffer(b"".join(part), "<f8").reshape(len(part), -1)
        blocks.append((weight * block).astype(np.float32))
    return np.concatenate(blocks, axis=1)
