"""Binary rows of fields, as in ply and binary off files; a field may be a list with its length before it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from unbend.arrays import Indices
from unbend.errors import MeshReadError
from unbend.mesh.formats.follow import DOUBLE, ENDED, SCALAR, SIGNED, SINGLE, STRANGE, UNSIGNED, follow, gather

Column = tuple[Any, Indices]
"""The values of a field, row after row, and how many each row has."""


@dataclass(frozen=True)
class Field:
    """One value of each row, or a list of them."""

    name: str
    kind: str
    """The NumPy type of a value, with its order of bytes."""
    counter: str = ""
    """The type of the number before the values of a list; empty for a single value."""

    @property
    def width(self) -> int:
        """Bytes of a value."""
        return np.dtype(self.kind).itemsize

    @property
    def counter_width(self) -> int:
        """Bytes of the number before a list's values, 0 for a single value."""
        return np.dtype(self.counter).itemsize if self.counter else 0


@dataclass(frozen=True)
class Rows:
    """Rows: their values, and where they lie."""

    columns: dict[str, Column]
    begins: Indices
    """The place of each row in the bytes."""
    end: int


def read_rows(body: bytes, start: int, length: int, fields: tuple[Field, ...]) -> Rows:
    """Return `length` rows that lie in `body` from `start` on.

    Raises
    ------
    MeshReadError
        If the bytes end before the rows do, or a list has an impossible length. Rows that cannot be there get no
        memory.
    """
    least = sum(field.counter_width or field.width for field in fields)
    if start + least * length > len(body):
        raise MeshReadError(f"the file ends early: {length:,} rows announced, and there is no room for them")
    if length == 0 or not fields:
        nothing = np.empty(0), np.empty(0, np.int64)
        return Rows({field.name: nothing for field in fields}, np.empty(0, np.int64), start)
    return _alike(body, start, length, fields) or _one_by_one(body, start, length, fields)


def _alike(body: bytes, start: int, length: int, fields: tuple[Field, ...]) -> Rows | None:
    """Return rows whose lists are all as long as in the first row; None if they are not."""
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
    """Return the length before a list, -1 if it is missing or impossible."""
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
        raise MeshReadError("the file ends early: rows that it announces are missing")
    if end == STRANGE:
        raise MeshReadError(f"a list of {number:.15g} values")
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
