"""The mark of an unfinished library: the target of a move between databases has it until every row is there."""

from __future__ import annotations

from typing import Final

from sqlalchemy import Column, Connection, MetaData, String, Table, insert, inspect, select

from unbend.errors import StoreUnfinishedError

_mark: Final = Table("unfinished_move", MetaData(), Column("origin", String(32), primary_key=True))


def refuse(connection: Connection) -> None:
    """Raise StoreUnfinishedError if a library is unfinished."""
    if origin(connection) is not None:
        raise StoreUnfinishedError("the library is unfinished: its move from another database was interrupted")


def origin(connection: Connection) -> str | None:
    """Return the epoch of the library whose move into this one is unfinished; None if there is none."""
    if not inspect(connection).has_table(_mark.name):
        return None
    return connection.scalar(select(_mark.c.origin))


def begin(connection: Connection, epoch: str) -> None:
    """Mark an empty library as the target of a move from the library with this epoch."""
    _mark.create(connection)
    connection.execute(insert(_mark).values(origin=epoch))


def end(connection: Connection) -> None:
    """Remove the mark."""
    _mark.drop(connection)
