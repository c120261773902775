"""The counters behind seqs and ids: a seq never comes again, even if the newest rows were removed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Final

from sqlalchemy import Column, Connection, Table, func, select, text

from unbend.library.storage.schema import metadata

_SEQUENCE: Final = text("SELECT pg_get_serial_sequence(:table, :column)")
_SET: Final = text("SELECT setval(pg_get_serial_sequence(:table, :column), :value)")
_COUNTER: Final = text("SELECT seq FROM sqlite_sequence WHERE name = :table")
_FORGET: Final = text("DELETE FROM sqlite_sequence WHERE name = :table")
_REMEMBER: Final = text("INSERT INTO sqlite_sequence (name, seq) VALUES (:table, :value)")


def read_counters(connection: Connection) -> dict[str, int]:
    """Return the last number that each counter of a library gave, by table; 0 if it gave none."""
    return {table.name: _read(connection, table, column) for table, column in _counted(connection)}


def set_counters(connection: Connection, counters: Mapping[str, int]) -> None:
    """Set each counter of a library behind the largest number in its table and behind that of another library."""
    for table, column in _counted(connection):
        largest = connection.scalar(select(func.max(column))) or 0
        value = max(largest, counters.get(table.name, 0))
        if not value:
            continue
        if connection.dialect.name == "postgresql":
            connection.execute(_SET, {"table": table.name, "column": column.name, "value": value})
        else:
            connection.execute(_FORGET, {"table": table.name})
            connection.execute(_REMEMBER, {"table": table.name, "value": value})


def _counted(connection: Connection) -> Iterator[tuple[Table, Column[int]]]:
    """Yield the tables whose keys a counter of the database gives; SQLite has fewer of them."""
    for table in metadata.sorted_tables:
        column = table.autoincrement_column
        if column is None or column.foreign_keys:
            continue
        if connection.dialect.name == "postgresql" or table.dialect_options["sqlite"]["autoincrement"]:
            yield table, column


def _read(connection: Connection, table: Table, column: Column[int]) -> int:
    if connection.dialect.name != "postgresql":
        return connection.scalar(_COUNTER, {"table": table.name}) or 0
    name = connection.scalar(_SEQUENCE, {"table": table.name, "column": column.name})
    state = connection.execute(text(f"SELECT last_value, is_called FROM {name}")).one()  # noqa: S608  its own name
    return int(state.last_value) if state.is_called else 0
