"""Vectors, classes and places of many shapes, in arrays that grow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from unbend.arrays import Bools, Codes, Floats, Indices, Singles
from unbend.errors import StoreError
from unbend.matching.gallery import UNLABELLED, Gallery
from unbend.matching.measures import VectorMeasure

_COMPACT: Final = 4
"""Rows of removed shapes are dropped when they are one in so many."""


@dataclass(frozen=True)
class Held:
    """What a table held at one moment. It stays as it is while the table grows and changes."""

    gallery: Gallery
    seqs: Indices
    """Place of each row's shape in the order of adding, (n,); ascending."""
    left_out: Indices
    """Rows that take no part, (r,); ascending. Those of shapes that are gone have no class."""

    def __len__(self) -> int:
        return len(self.seqs) - len(self.left_out)

    def row(self, seq: int) -> int | None:
        """Return the row of a shape; None where it is not held."""
        row = int(np.searchsorted(self.seqs, seq))
        there = row < len(self.seqs) and self.seqs[row] == seq and row not in self.left_out
        return row if there else None

    def without(self, row: int) -> Self:
        """Return the same, of which one row takes no part."""
        return replace(self, left_out=np.union1d(self.left_out, row))

    def distances(self, query: Singles, measure: VectorMeasure) -> Floats:
        """Return the distance from `query` (d,) to each row, (n,); infinite where it takes no part."""
        distances = measure.distances(query, self.gallery.vectors)
        distances[self.left_out] = np.inf
        return distances


class Table:
    """Rows in the order of adding. Only one thread may change it at a time; what it gave out never changes.

    New rows are written behind those that were given out, into arrays that double when they are full; new classes
    of old rows are written into a copy. So a shape more among a million costs as little as one among ten.
    """

    def __init__(self) -> None:
        self._count = 0
        self._vectors: Singles = np.empty((0, 0), np.float32)
        self._codes: Codes = np.empty(0, np.int32)
        self._seqs: Indices = np.empty(0, np.int64)
        self._removed: Indices = np.empty(0, np.int64)
        self._places: dict[str | None, int] = {None: UNLABELLED}
        self._labels: tuple[str, ...] = ()

    def __len__(self) -> int:
        return self._count

    def held(self) -> Held:
        """Return what is there now."""
        gallery = Gallery(_shown(self._vectors, self._count), _shown(self._codes, self._count), self._labels)
        return Held(gallery, _shown(self._seqs, self._count), self._removed)

    def append(self, seqs: Sequence[int], labels: Sequence[str | None], vectors: Singles) -> None:
        """Add rows whose `seqs` are larger than all before.

        Raises
        ------
        StoreError
            If `vectors` (n, d) have not as many numbers as those before.
        """
        self._make_room(*vectors.shape)
        end = self._count + len(vectors)
        new = slice(self._count, end)
        self._vectors[new], self._codes[new], self._seqs[new] = vectors, self._as_codes(labels), seqs
        self._count = end

    def relabel(self, seqs: Sequence[int], labels: Sequence[str | None]) -> None:
        """Set the classes of some rows; shapes that are not held are passed over."""
        rows, found = self._find(seqs)
        self._set_codes(rows, self._as_codes([label for label, held in zip(labels, found, strict=True) if held]))

    def remove(self, seqs: Sequence[int]) -> None:
        """Leave out some rows; shapes that are not held are passed over."""
        rows, _ = self._find(seqs)
        self._set_codes(rows, UNLABELLED)
        self._removed = np.union1d(self._removed, rows)
        if len(self._removed) * _COMPACT > self._count:
            self._compact()

    def _find(self, seqs: Sequence[int]) -> tuple[Indices, Bools]:
        """Return the rows of those that are held, and which those are."""
        wanted, known = np.asarray(seqs, np.int64), self._seqs[: self._count]
        rows = np.searchsorted(known, wanted)
        found = rows < self._count
        found[found] = known[rows[found]] == wanted[found]
        return rows[found], found

    def _as_codes(self, labels: Sequence[str | None]) -> Codes:
        for label in dict.fromkeys(labels):
            if label is not None and label not in self._places:
                self._places[label] = len(self._labels)
                self._labels += (label,)
        return np.array([self._places[label] for label in labels], np.int32)

    def _set_codes(self, rows: Indices, codes: Codes | int) -> None:
        if len(rows):
            self._codes = _grown(self._codes, self._count, len(self._codes))
            self._codes[rows] = codes

    def _make_room(self, rows: int, width: int) -> None:
        if not self._count:
            self._vectors = np.empty((0, width), np.float32)
        if width != self._vectors.shape[1]:
            raise StoreError(f"a stored descriptor has {width} numbers where others have {self._vectors.shape[1]}")
        needed = self._count + rows
        if needed > len(self._seqs):
            size = max(needed, 2 * len(self._seqs))
            self._vectors = _grown(self._vectors, self._count, size)
            self._codes = _grown(self._codes, self._count, size)
            self._seqs = _grown(self._seqs, self._count, size)

    def _compact(self) -> None:
        kept = np.ones(self._count, bool)
        kept[self._removed] = False
        self._vectors = self._vectors[: self._count][kept]
        self._codes = self._codes[: self._count][kept]
        self._seqs = self._seqs[: self._count][kept]
        self._count = len(self._seqs)
        self._removed = np.empty(0, np.int64)


def _grown(array: NDArray[Any], count: int, size: int) -> NDArray[Any]:
    """Return a copy of the first `count` rows, with room for `size`. What is not written yet takes no memory."""
    result = np.empty((size, *array.shape[1:]), array.dtype)
    result[:count] = array[:count]
    return result


def _shown(array: NDArray[Any], count: int) -> NDArray[Any]:
    view = array[:count]
    view.flags.writeable = False
    return view
