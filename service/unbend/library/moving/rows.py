"""Rows as a database has them: JSON as text, times as seconds; and a hash of each row, which is the same everywhere."""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Sequence
from typing import Any, Final

from sqlalchemy import (
    JSON,
    ColumnElement,
    Connection,
    Float,
    LargeBinary,
    Select,
    Table,
    Text,
    cast,
    column,
    func,
    insert,
    literal,
    select,
    table,
    tuple_,
)
from sqlalchemy.exc import DBAPIError

from unbend.errors import MoveError
from unbend.library.storage.schema import Instant

Key = tuple[Any, ...]
"""The primary key of a row."""

Values = dict[str, Any]
"""The values of a row, by column."""

_MOST_ROWS: Final = 500
"""Largest number of rows in one statement: SQLite limits the number of its arguments."""

_PIECE: Final = 4 * 2**20
"""Bytes of a binary value that PostgreSQL sends at a time."""

_SHOWN: Final = 200
"""Characters of a database's message that an error has."""


class RawTable:
    """A table of an open database, without the conversions of its column types.

    Parameters
    ----------
    connection : Connection
        A connection in a transaction.
    defined : Table
    """

    def __init__(self, connection: Connection, defined: Table) -> None:
        self.name = defined.name
        self._connection = connection
        self._names = [each.name for each in defined.columns]
        self._key = [each.name for each in defined.primary_key.columns]
        self._floats = {each.name for each in defined.columns if isinstance(each.type, Float | Instant)}
        # Columns without types, so that values pass unchanged.
        self._raw = table(defined.name, *map(column, self._names))
        is_postgres = connection.dialect.name == "postgresql"
        self._as_text = {each.name for each in defined.columns if is_postgres and isinstance(each.type, JSON)}
        self._in_pieces = {each.name for each in defined.columns if is_postgres and isinstance(each.type, LargeBinary)}
        self._large = [
            func.coalesce(func.length(self._column(each.name)), 0)
            for each in defined.columns
            if isinstance(each.type, JSON | LargeBinary)
        ]

    def count(self) -> int:
        """Return the number of rows."""
        return self._connection.scalar(select(func.count()).select_from(self._raw)) or 0

    def keys(self, after: Key | None) -> list[tuple[Key, int]]:
        """Return the next keys in this database's order, after one of them, and the bytes of each row's large values.

        The list is empty at the end of the table. Databases may order text differently.
        """
        key = [self._raw.c[name] for name in self._key]
        wanted: Select[Any] = select(*key, sum(self._large, literal(0))).order_by(*key).limit(_MOST_ROWS)
        if after is not None:
            wanted = wanted.where(tuple_(*key) > tuple_(*after)) if len(key) > 1 else wanted.where(key[0] > after[0])
        return [(tuple(row[:-1]), row[-1]) for row in self._connection.execute(wanted)]

    def read(self, keys: Sequence[Key]) -> dict[Key, Values]:
        """Return the rows with these keys, at most as many as `keys` returns at a time.

        Raises
        ------
        MoveError
            If a row cannot be read; the message names the row.
        """
        try:
            return self._read(keys)
        except DBAPIError:
            if len(keys) == 1:
                raise
        found: dict[Key, Values] = {}
        for key in keys:
            try:
                found |= self._read([key])
            except DBAPIError as error:
                raise MoveError(f"{self.named(key)} cannot be read: {_reason(error)}") from error
        return found

    def insert(self, rows: Sequence[Values]) -> None:
        """Add rows."""
        self._connection.execute(insert(self._raw), list(rows))

    def refusal(self, values: Values, error: DBAPIError) -> MoveError:
        """Return the error of a row that the database does not store."""
        nul = [name for name, value in values.items() if isinstance(value, str) and "\0" in value]
        is_nul = nul and self._connection.dialect.name == "postgresql"
        reason = f"its {nul[0]} has a NUL character, which PostgreSQL does not store" if is_nul else _reason(error)
        return MoveError(f"{self.named(self.key_of(values))} cannot be stored: {reason}")

    def key_of(self, values: Values) -> Key:
        """Return the key of a row."""
        return tuple(values[name] for name in self._key)

    def digest(self, values: Values) -> bytes:
        """Return a hash of a row's values and their types."""
        found = hashlib.sha256()
        for name in self._names:
            kind, encoded = _encode(values[name], name in self._floats)
            found.update(b"%c%d:" % (kind, len(encoded)))
            found.update(encoded)
        return found.digest()

    def digests(self, keys: Sequence[Key]) -> dict[Key, bytes]:
        """Return the hashes of the rows with these keys, where there are any."""
        return {key: self.digest(values) for key, values in self.read(keys).items()}

    def named(self, key: Key) -> str:
        """Return what an error calls a row."""
        parts = ", ".join(f"{name} {value}" for name, value in zip(self._key, key, strict=True))
        return f"the row of {self.name} with {parts}"

    def _read(self, keys: Sequence[Key]) -> dict[Key, Values]:
        wanted = select(*map(self._column, self._names)).where(self._is_one_of(keys))
        # All rows, before `_complete` uses the connection.
        found = [dict(zip(self._names, row, strict=True)) for row in self._connection.execute(wanted).all()]
        for values in found:
            for name in self._in_pieces:
                if values[name] is not None and len(values[name]) == _PIECE:
                    values[name] = self._complete(name, values)
        return {self.key_of(values): values for values in found}

    def _complete(self, name: str, values: Values) -> bytearray:
        """Return a binary value of which a row has only the first piece."""
        whole, piece = bytearray(values[name]), values[name]
        this = self._is_one_of([self.key_of(values)])
        while len(piece) == _PIECE:
            wanted = select(func.substr(self._raw.c[name], len(whole) + 1, _PIECE)).where(this)
            piece = self._connection.execute(wanted).scalar_one()
            whole += piece
        return whole

    def _is_one_of(self, keys: Sequence[Key]) -> ColumnElement[bool]:
        key = [self._raw.c[name] for name in self._key]
        return tuple_(*key).in_(keys) if len(key) > 1 else key[0].in_([each for (each,) in keys])

    def _column(self, name: str) -> ColumnElement[Any]:
        """Return a column to select: the first piece of a binary one, or JSON as text, from PostgreSQL.

        PostgreSQL sends a binary value as text of twice its size. Its driver would parse JSON.
        """
        if name in self._in_pieces:
            return func.substr(self._raw.c[name], 1, _PIECE).label(name)
        return cast(self._raw.c[name], Text).label(name) if name in self._as_text else self._raw.c[name]


def _encode(value: Any, is_float: bool) -> tuple[int, bytes | bytearray]:
    """Return a letter for the type of a value, and its bytes."""
    if value is None:
        return ord("n"), b""
    if is_float and isinstance(value, int | float):
        return ord("f"), struct.pack("<d", value + 0.0)  # SQLite stores whole numbers as integers, and no -0.0
    if isinstance(value, str):
        return ord("s"), value.encode()
    if isinstance(value, bytes | bytearray):
        return ord("b"), value
    return ord(type(value).__name__[0].upper()), repr(value).encode()


def _reason(error: DBAPIError) -> str:
    """Return the first line of what the database's driver says."""
    lines = str(error.orig).splitlines()
    return lines[0][:_SHOWN] if lines else "the database does not say why"
