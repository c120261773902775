"""Whether a library's file holds what a library may hold: each hash, reference and document, row by row.

A backup may have been damaged, or prepared to do harm. Nothing of its schema is trusted: a trigger could write keys.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
import sqlite3
from collections.abc import Callable, Iterator
from datetime import datetime
from typing import Final

import numpy as np

from unbend.errors import BackupError
from unbend.library.answers import is_packed
from unbend.library.payload import unpack_signature, unpack_vector
from unbend.library.schema import metadata
from unbend.library.values import read_metadata
from unbend.mesh.policy import MeshPolicy
from unbend.signature.parameters import Parameters

_PIECE: Final = 2**20
_STATES: Final = {"queued", "running", "succeeded", "failed", "cancelled"}
_ID: Final = re.compile(r"[0-9a-f]{32}")
_HASH: Final = re.compile(r"[0-9a-f]{64}")
_FEATURES: Final = {"trigger": "a trigger", "view": "a view"}
_STORED: Final = {"INTEGER": ("integer",), "FLOAT": ("real", "integer"), "BLOB": ("blob",)}
"""How SQLite may store a column's values; all others are text."""

_MOST_SECONDS: Final = 253_402_300_799.0
"""The end of the year 9999."""

Row = sqlite3.Row


def distrust(connection: sqlite3.Connection) -> None:
    """Have SQLite trust nothing that the schema of a file says, and look at each page closely."""
    connection.execute("PRAGMA trusted_schema = OFF")
    connection.execute("PRAGMA cell_size_check = ON")


def check_schema(connection: sqlite3.Connection) -> None:
    """Raise BackupError, whose message begins with a verb, if a file has anything beside tables and their indexes."""
    for kind, name in connection.execute("SELECT type, name FROM sqlite_master"):
        if kind in _FEATURES:
            raise BackupError(f"has {_FEATURES[kind]}, {name!r}, which no library has")
        if kind == "table" and str(name).startswith("sqlite_") and name not in {"sqlite_sequence", "sqlite_stat1"}:
            raise BackupError(f"has a table {name!r}, which no library has")
    for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE sql LIKE 'CREATE VIRTUAL%'"):
        raise BackupError(f"has a virtual table, {name!r}, which no library has")


def check_rows(connection: sqlite3.Connection) -> None:
    """Check every row of a library whose schema is today's.

    Parameters
    ----------
    connection : sqlite3.Connection
        Reading one state.

    Raises
    ------
    BackupError
        The message names the row, and says what is wrong with it.
    """
    connection.row_factory = sqlite3.Row
    _check_kinds(connection)
    if connection.execute("SELECT count(*) FROM library_state").fetchone()[0] != 1:
        raise BackupError("library_state has not one row")
    for table, check in _CHECKS.items():
        for row in _rows(connection, table):
            try:
                check(connection, row)
            except BackupError:
                raise
            except (ValueError, TypeError, KeyError, LookupError, OverflowError, RecursionError) as error:
                raise BackupError(f"{_named(table, row)} holds what cannot be read: {error}") from error


def _rows(connection: sqlite3.Connection, table: str) -> Iterator[Row]:
    columns = [column.name for column in metadata.tables[table].columns if (table, column.name) != ("meshes", "data")]
    yield from connection.execute(f"SELECT rowid AS rowid_, {', '.join(columns)} FROM {table}")  # noqa: S608  ours


def _check_kinds(connection: sqlite3.Connection) -> None:
    """SQLite stores what it is given, whatever a column is declared as."""
    for table in metadata.sorted_tables:
        for column in table.columns:
            declared = str(column.type.compile()).split("(", maxsplit=1)[0]
            allowed = ", ".join(f"'{kind}'" for kind in _STORED.get(declared, ("text",)))
            wrong = f"typeof({column.name}) NOT IN ({allowed})"
            if column.nullable:
                wrong += f" AND {column.name} IS NOT NULL"
            found = connection.execute(f"SELECT rowid FROM {table.name} WHERE {wrong} LIMIT 1").fetchone()  # noqa: S608
            if found:
                raise BackupError(f"row {found[0]} of {table.name} has a {column.name} of the wrong type")


def _check_mesh(connection: sqlite3.Connection, row: Row) -> None:
    found, size = hashlib.sha256(), 0
    with connection.blobopen("meshes", "data", row["rowid_"], readonly=True) as blob:
        while piece := blob.read(_PIECE):
            found.update(piece)
            size += len(piece)
    if found.hexdigest() != row["sha256"] or size != row["size"]:
        raise BackupError(f"the file of mesh {row['sha256'][:64]} is not the one that was uploaded: it is damaged")


def _check_signature(_connection: sqlite3.Connection, row: Row) -> None:
    Parameters.from_json(row["parameters"])
    MeshPolicy.from_json(row["policy"])
    _object(row["report"], "report")
    _texts(row["warnings"], "warnings")
    _must(math.isfinite(row["area"]) and math.isfinite(row["stress"]), "a figure that is not finite")
    try:
        signature = unpack_signature(row["payload"])
    except Exception as error:  # of a damaged archive anything may be raised
        raise ValueError(f"no signature: {error}") from error
    _must(signature.points.ndim == 2 and bool(np.isfinite(signature.points).all()), "a signature that is not finite")
    corners = signature.faces
    _must(corners.ndim == 2 and corners.shape[1] == 3, "a signature whose faces are no triangles")
    _must(not corners.size or 0 <= corners.min() <= corners.max() < len(signature.points), "faces of no points")


def _check_descriptor(_connection: sqlite3.Connection, row: Row) -> None:
    _must(len(row["vector"]) % 8 == 0 and bool(np.isfinite(unpack_vector(row["vector"])).all()), "a broken vector")


def _check_shape(_connection: sqlite3.Connection, row: Row) -> None:
    _must(bool(_ID.fullmatch(row["id"])), "an id of another form")
    read_metadata(row["metadata"])  # one that is too deep is shown without
    _moments(row, "created_at", "updated_at")


def _check_job(_connection: sqlite3.Connection, row: Row) -> None:
    _must(bool(_ID.fullmatch(row["id"])), "an id of another form")
    _must(row["state"] in _STATES, "a state that there is not")
    _must(row["kind"] in {"shape", "query", "file"}, "a kind that there is not")
    _must(0.0 <= row["progress"] <= 1.0, "a progress beyond its bounds")
    _must(row["mesh_sha256"] is not None or row["state"] not in {"queued", "running"}, "no mesh, though it waits")
    _object(row["request"], "request")
    for column in ("warnings", "ignored"):
        _texts(row[column], column)
    error = json.loads(row["error"] or "null")
    _must(error is None or {"code", "message", "advice"} <= set(error), "an error without a code")
    _must(is_packed(json.loads(row["result"] or "null")), "an answer of another form")
    _moments(row, "created_at", "started_at", "finished_at")


def _check_key(_connection: sqlite3.Connection, row: Row) -> None:
    _must(row["scope"] in {"read", "write", "admin"}, "a scope that there is not")
    _must(bool(_HASH.fullmatch(row["sha256"])), "a hash of another form")
    _moments(row, "created_at", "revoked_at", "expires_at")


_CHECKS: Final[dict[str, Callable[[sqlite3.Connection, Row], None]]] = {
    "meshes": _check_mesh,
    "signatures": _check_signature,
    "descriptors": _check_descriptor,
    "shapes": _check_shape,
    "jobs": _check_job,
    "api_keys": _check_key,
}


def _must(holds: bool, otherwise: str) -> None:
    if not holds:
        raise ValueError(otherwise)


def _object(text: str, what: str) -> None:
    _must(isinstance(json.loads(text), dict), f"a {what} that is no object")


def _texts(text: str, what: str) -> None:
    value = json.loads(text)
    _must(isinstance(value, list) and all(isinstance(each, str) for each in value), f"{what} that are no texts")


def _moments(row: Row, *columns: str) -> None:
    for column in columns:
        if row[column] is not None:
            _must(0.0 <= row[column] <= _MOST_SECONDS, f"a time, {column}, that there is not")
            datetime.fromtimestamp(row[column])


def _named(table: str, row: Row) -> str:
    return f"row {row['rowid_']} of {table}"
