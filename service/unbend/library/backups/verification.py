"""Checks of the content of a library's file, row by row: hashes, references and documents.

A backup may be damaged or malicious. Its schema is not trusted, because a trigger could insert API keys.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
import sqlite3
from collections.abc import Callable, Iterator
from datetime import datetime
from typing import Final, get_args

import numpy as np

from unbend.errors import BackupError
from unbend.library.metadata import read_metadata
from unbend.library.packing import unpack_local, unpack_signature
from unbend.library.storage.schema import metadata
from unbend.library.stored_rankings import is_packed
from unbend.local.signatures import RUNGS
from unbend.mesh.policy import MeshPolicy
from unbend.results.jobs import UNFINISHED_STATES, JobKind, JobState
from unbend.signature.parameters import Parameters

_PIECE: Final = 2**20
_ID: Final = re.compile(r"[0-9a-f]{32}")
_HASH: Final = re.compile(r"[0-9a-f]{64}")
_FEATURES: Final = {"trigger": "a trigger", "view": "a view"}
_STORED: Final = {"INTEGER": ("integer",), "BIGINT": ("integer",), "FLOAT": ("real", "integer"), "BLOB": ("blob",)}
"""SQLite's storage classes by column type; columns of all other types store text."""

_LATEST: Final = 253_402_300_799.0
"""The end of the year 9999."""

Row = sqlite3.Row


def distrust(connection: sqlite3.Connection) -> None:
    """Make SQLite distrust the schema of a file, and check the cells of each page."""
    connection.execute("PRAGMA trusted_schema = OFF")
    connection.execute("PRAGMA cell_size_check = ON")


def check_schema(connection: sqlite3.Connection) -> None:
    """Raise BackupError, whose message begins with a verb, if a file has more than tables and their indexes."""
    for kind, name in connection.execute("SELECT type, name FROM sqlite_master"):
        if kind in _FEATURES:
            raise BackupError(f"has {_FEATURES[kind]}, {name!r}, which libraries do not have")
        if kind == "table" and str(name).startswith("sqlite_") and name not in {"sqlite_sequence", "sqlite_stat1"}:
            raise BackupError(f"has a table {name!r}, which libraries do not have")
    for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE sql LIKE 'CREATE VIRTUAL%'"):
        raise BackupError(f"has a virtual table, {name!r}, which libraries do not have")


def check_rows(connection: sqlite3.Connection) -> None:
    """Check every row of a library of the present schema.

    Parameters
    ----------
    connection : sqlite3.Connection
        A connection in a transaction.

    Raises
    ------
    BackupError
        The message names the row and the problem.
    """
    connection.row_factory = sqlite3.Row
    _check_kinds(connection)
    if connection.execute("SELECT count(*) FROM library_state").fetchone()[0] != 1:
        raise BackupError("library_state must have exactly one row")
    for table, check in _CHECKS.items():
        for row in _rows(connection, table):
            try:
                check(connection, row)
            except BackupError:
                raise
            except (ValueError, TypeError, KeyError, LookupError, OverflowError, RecursionError) as error:
                raise BackupError(f"{_named(table, row)} cannot be read: {error}") from error


def _rows(connection: sqlite3.Connection, table: str) -> Iterator[Row]:
    columns = [column.name for column in metadata.tables[table].columns if (table, column.name) != ("meshes", "data")]
    if table == "meshes":
        columns.append("data IS NULL AS is_elsewhere")
    yield from connection.execute(f"SELECT rowid AS rowid_, {', '.join(columns)} FROM {table}")  # noqa: S608  ours


def _check_kinds(connection: sqlite3.Connection) -> None:
    """Check storage classes, because SQLite stores a value of any type in any column."""
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
    if row["is_elsewhere"]:  # the object store checks its bytes when it reads them
        _must(bool(_HASH.fullmatch(row["sha256"])) and row["size"] >= 0, "a malformed hash or size")
        return
    found, size = hashlib.sha256(), 0
    with connection.blobopen("meshes", "data", row["rowid_"], readonly=True) as blob:
        while piece := blob.read(_PIECE):
            found.update(piece)
            size += len(piece)
    if found.hexdigest() != row["sha256"] or size != row["size"]:
        raise BackupError(f"the file of mesh {row['sha256'][:64]} is not the uploaded file: it is damaged")


def _check_signature(_connection: sqlite3.Connection, row: Row) -> None:
    Parameters.from_json(row["parameters"])
    MeshPolicy.from_json(row["policy"])
    _check_object(row["report"], "report")
    _check_texts(row["warnings"], "warnings")
    _must(math.isfinite(row["area"]) and math.isfinite(row["stress"]), "a number that is not finite")
    try:
        signature = unpack_signature(row["payload"], {})
    except Exception as error:  # a damaged archive raises all kinds of errors
        raise ValueError(f"no signature: {error}") from error
    _must(signature.points.ndim == 2 and bool(np.isfinite(signature.points).all()), "a signature that is not finite")
    corners = signature.faces
    _must(corners.ndim == 2 and corners.shape[1] == 3, "a signature whose faces are not triangles")
    _must(
        not corners.size or 0 <= corners.min() <= corners.max() < len(signature.points),
        "faces with missing corners",
    )


def _check_descriptor(_connection: sqlite3.Connection, row: Row) -> None:
    vector = row["vector"]
    _must(len(vector) % 8 == 0 and bool(np.isfinite(np.frombuffer(vector, "<f8")).all()), "a broken vector")


def _check_local(_connection: sqlite3.Connection, row: Row) -> None:
    try:
        local = unpack_local(row["payload"])
    except Exception as error:  # a damaged archive raises all kinds of errors
        raise ValueError(f"no local signatures: {error}") from error
    count = len(local)
    _must(local.growth.shape == (count, RUNGS) and local.reach.shape == (count,), "local signatures of a wrong shape")
    _must(bool(np.isfinite(local.growth).all() and np.isfinite(local.distances).all()), "circles that are not finite")


def _check_shape(_connection: sqlite3.Connection, row: Row) -> None:
    _must(bool(_ID.fullmatch(row["id"])), "a malformed id")
    read_metadata(row["metadata"])  # metadata that is nested too deeply is allowed
    _check_times(row, "created_at", "updated_at")


def _check_job(_connection: sqlite3.Connection, row: Row) -> None:
    _must(bool(_ID.fullmatch(row["id"])), "a malformed id")
    _must(row["state"] in get_args(JobState), "an unknown state")
    _must(row["kind"] in get_args(JobKind), "an unknown kind")
    _must(0.0 <= row["progress"] <= 1.0, "a progress out of its range")
    _must(row["mesh_sha256"] is not None or row["state"] not in UNFINISHED_STATES, "no mesh before its end")
    _check_object(row["request"], "request")
    for column in ("warnings", "ignored"):
        _check_texts(row[column], column)
    error = json.loads(row["error"] or "null")
    _must(error is None or {"code", "message", "advice"} <= set(error), "an error without a code")
    _must(is_packed(json.loads(row["result"] or "null")), "a malformed result")
    _check_times(row, "created_at", "started_at", "finished_at")


def _check_key(_connection: sqlite3.Connection, row: Row) -> None:
    _must(row["scope"] in {"read", "write", "admin"}, "an unknown scope")
    _must(bool(_HASH.fullmatch(row["sha256"])), "a malformed hash")
    _check_times(row, "created_at", "revoked_at", "expires_at")


def _check_write(_connection: sqlite3.Connection, row: Row) -> None:
    _must(bool(_HASH.fullmatch(row["sha256"])), "a malformed hash")
    _check_times(row, "at")


def _check_deletion(_connection: sqlite3.Connection, row: Row) -> None:
    _must(bool(_HASH.fullmatch(row["sha256"])), "a malformed hash")
    _check_times(row, "at", "claimed_at")


_CHECKS: Final[dict[str, Callable[[sqlite3.Connection, Row], None]]] = {
    "meshes": _check_mesh,
    "signatures": _check_signature,
    "descriptors": _check_descriptor,
    "local_signatures": _check_local,
    "shapes": _check_shape,
    "jobs": _check_job,
    "api_keys": _check_key,
    "object_writes": _check_write,
    "object_deletions": _check_deletion,
}


def _must(condition: bool, otherwise: str) -> None:
    if not condition:
        raise ValueError(otherwise)


def _check_object(text: str, what: str) -> None:
    _must(isinstance(json.loads(text), dict), f"a {what} that is not an object")


def _check_texts(text: str, what: str) -> None:
    value = json.loads(text)
    _must(isinstance(value, list) and all(isinstance(each, str) for each in value), f"{what} that are not strings")


def _check_times(row: Row, *columns: str) -> None:
    for column in columns:
        if row[column] is not None:
            _must(0.0 <= row[column] <= _LATEST, f"a {column} out of range")
            datetime.fromtimestamp(row[column])


def _named(table: str, row: Row) -> str:
    return f"row {row['rowid_']} of {table}"
