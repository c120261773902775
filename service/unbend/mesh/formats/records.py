"""Binary rows of fields, as in ply and binary off files. A field may be a list that begins with its length."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from unbend.arrays import Indices
from unbend.errors import MeshReadError
from unbend.mesh.formats.follow import DOUBLE, ENDED, SCALAR, SIGNED, SINGLE, STRANGE, UNSIGNED, follow, gather

Column = tuple[Any, Indices]
"""The values of a field, row after row, and the number of values in each row."""


@dataclass(frozen=True)
class Field:
    """One value of each row, or a list of them."""

    name: str
    kind: str
    """The NumPy type of a value, with its byte order."""
    counter: str = ""
    """The type of the length that begins a list; empty for a single value."""

    @property
    def width(self) -> int:
        """Bytes of a value."""
        return np.dtype(self.kind).itemsize

    @property
    def counter_width(self) -> int:
        """Bytes of the length that begins a list, 0 for a single value."""
        return np.dtype(self.counter).itemsize if self.counter else 0


@dataclass(frozen=True)
class Rows:
    """The values of rows, and the positions of the rows."""

    columns: dict[str, Column]
    begins: Indices
    """The position of the first byte of each row."""
    end: int
    """The position after the last row."""


def read_rows(body: bytes, start: int, length: int, fields: tuple[Field, ...]) -> Rows:
    """Return `length` rows from `body`, starting at `start`.

    Raises
    ------
    MeshReadError
        If the bytes end before the rows do, or a list has an impossible length. No memory is allocated for more rows
        than the bytes can contain.
    """
    least = sum(field.counter_width or field.width for field in fields)
    if start + least * length > len(body):
        raise MeshReadError(f"the file ends early: it announces {length:,} rows, which need more bytes than it has")
    if length == 0 or not fields:
        nothing = np.empty(0), np.empty(0, np.int64)
        return Rows({field.name: nothing for field in fields}, np.empty(0, np.int64), start)
    return _alike(body, start, length, fields) or _one_by_one(body, start, length, fields)


def _alike(body: bytes, start: int, length: int, fields: tuple[Field, ...]) -> Rows | None:
    """Return rows in which every list is as long as in the first row; None if the lengths differ."""
    places, position = [], start
    for field in fields:
        count = 1
        if field.counter:
            count = _count(body, position, field.counter)
            position += field.counter_width
        places.append((position, count))
        position += count * field.width
        if count < 0 or position > len(body):
            return None
    row = position - start
    if start + row * length > len(body):
        return None
    columns = {}
    for field, (place, count) in zip(fields, places, strict=True):
        if field.counter:
            counts: Any = np.ndarray((length,), field.counter, body, place - field.counter_width, (row,))
            if (counts != count).any():
                return None
        values: Any = np.ndarray((length, count), field.kind, body, place, (row, field.width))
        columns[field.name] = values.ravel(), np.full(length, count)
    return Rows(columns, start + row * np.arange(length), start + row * length)


def _count(body: bytes, position: int, counter: str) -> int:
    """Return the length that begins a list, -1 if it is missing or impossible."""
    if position + np.dtype(counter).itemsize > len(body):
        return -1
    number = float(np.frombuffer(body, counter, 1, position)[0])
    return int(number) if 0 <= number < np.inf and number == np.floor(number) else -1


def _one_by_one(body: bytes, start: int, length: int, fields: tuple[Field, ...]) -> Rows:
    raw = np.frombuffer(body, np.uint8)
    shape = (length, len(fields))
    places, counts = np.empty(shape, np.int64), np.empty(shape, np.int64)
    widths = np.array([field.width for field in fields])
    kinds = np.array([_kind(field.counter) for field in fields])
    sizes = np.array([field.counter_width for field in fields])
    big = any(field.counter.startswith(">") for field in fields)
    end, number = follow(raw, start, widths, kinds, sizes, big, places, counts)
    if end == ENDED:
        raise MeshReadError("the file ends early: it has fewer rows than it announces")
    if end == STRANGE:
        raise MeshReadError(f"a list has the invalid length {number:.15g}")
    columns = {
        field.name: (_gathered(raw, field, places[:, number].copy(), counts[:, number].copy()), counts[:, number])
        for number, field in enumerate(fields)
    }
    return Rows(columns, places[:, 0] - sizes[0], end)


def _kind(counter: str) -> int:
    if not counter:
        return SCALAR
    kind = np.dtype(counter)
    if kind.kind == "f":
        return SINGLE if kind.itemsize == 4 else DOUBLE
    return SIGNED if kind.kind == "i" else UNSIGNED


def _gathered(raw: Any, field: Field, places: Indices, counts: Indices) -> Any:
    found = np.empty(int(counts.sum()) * field.width, np.uint8)
    gather(raw, places, counts, field.width, found)
    return found.view(field.kind)
