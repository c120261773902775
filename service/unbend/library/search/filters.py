"""Filters of a search: only shapes of a class, or with given members of their metadata."""

from __future__ import annotations

import json

from sqlalchemy import ColumnElement, Connection, FromClause, and_, exists, func, literal, select

from unbend.library.metadata import Scalar
from unbend.library.requests import QueryRequest
from unbend.library.search.nearest import CONDITIONS, Filter, values_of
from unbend.library.storage.schema import shapes


def filter_of(request: QueryRequest) -> Filter:
    """Return the filter of a query."""
    return Filter(request.label, request.metadata)


def kept_seqs(connection: Connection, only: Filter) -> frozenset[int] | None:
    """Return the places in the order of adding of the shapes that a filter keeps; None if it keeps all."""
    if not only:
        return None
    wanted = select(shapes.c.seq)
    if connection.dialect.name == "postgresql":
        statement, values = wanted.where(*(CONDITIONS[name] for name in only.given)), values_of(only)
    else:
        statement, values = wanted.where(*_conditions(only)), {}
    return frozenset(connection.scalars(statement, values))


def _conditions(only: Filter) -> list[ColumnElement[bool]]:
    """Return a filter's conditions for SQLite."""
    of_label = [] if only.label is None else [shapes.c.label == only.label]
    return of_label + [_has_member(name, value) for name, value in only.metadata.items()]


def _has_member(name: str, value: Scalar) -> ColumnElement[bool]:
    """Return whether the metadata of a shape have a member with this value, of the same type of JSON."""
    # An earlier version may have stored metadata that are nested too deeply for SQLite.
    readable = func.iif(func.json_valid(shapes.c.metadata) == 1, shapes.c.metadata, "{}")
    member = func.json_each(readable).table_valued("key", "value", "type")
    return exists().select_from(member).where(member.c.key == name, _equals(member, value))


def _equals(member: FromClause, value: Scalar) -> ColumnElement[bool]:
    if value is None or isinstance(value, bool):
        return member.c.type == json.dumps(value)  # SQLite's names of these types are their values in JSON
    kinds = ("text",) if isinstance(value, str) else ("integer", "real")
    return and_(member.c.type.in_(kinds), member.c.value == literal(value))
