"""Shapes, their meshes, signatures and descriptors: reads and writes within the caller's transaction."""

from __future__ import annotations

import json
import uuid
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Final, Literal

from sqlalchemy import Connection, String, bindparam, cast, delete, exists, func, insert, select, update
from sqlalchemy.engine import Row

from unbend.errors import ChangedError, NotFoundError, ParameterError
from unbend.library.answers import forget_label
from unbend.library.erasing import mark_erased
from unbend.library.key import UploadKey
from unbend.library.payload import PackedSignature
from unbend.library.records import ShapeMatch, ShapePage, ShapeRecord
from unbend.library.schema import descriptors, job_files, jobs, library_state, meshes, removals, shapes, signatures
from unbend.library.values import read_metadata
from unbend.mesh.policy import MeshPolicy

MAX_PAGE = 500

# As text: what an earlier version stored may be nested more deeply than can be read.
_METADATA = cast(shapes.c.metadata, String).label("metadata")
_UNSHOWN: Final = "the metadata is nested too deeply to be shown: set it anew"
_COLUMNS = (
    shapes.c.id, shapes.c.name, shapes.c.label, _METADATA, meshes.c.sha256, meshes.c.size,
    signatures.c.parameters, signatures.c.policy, signatures.c.version, signatures.c.area, signatures.c.stress,
    signatures.c.dimension, signatures.c.report, signatures.c.warnings, shapes.c.created_at,
    shapes.c.updated_at, shapes.c.changed, shapes.c.seq,
)  # fmt: skip
_JOINED = shapes.join(signatures, shapes.c.signature_id == signatures.c.id).join(
    meshes, signatures.c.mesh_sha256 == meshes.c.sha256
)
# Made once: to make a statement costs more than to run it.
_GET = select(*_COLUMNS).select_from(_JOINED).where(shapes.c.id == bindparam("shape_id"))
_FIND = (
    select(*_COLUMNS)
    .select_from(_JOINED)
    .where(
        signatures.c.mesh_sha256 == bindparam("sha256"),
        signatures.c.parameters == bindparam("parameters"),
        signatures.c.policy == bindparam("policy"),
        signatures.c.version == bindparam("version"),
    )
)
_HAS_MESH = select(exists().where(meshes.c.sha256 == bindparam("sha256")))
_GET_MESH = select(meshes.c.data).where(meshes.c.sha256 == bindparam("sha256"))
_PUT_MESH, _ADD_DESCRIPTORS, _ADD_SHAPE = insert(meshes), insert(descriptors), insert(shapes)
_ADD_SIGNATURE = insert(signatures).returning(signatures.c.id)
_WANTED = select(
    exists().where(signatures.c.mesh_sha256 == bindparam("sha256"))
    | exists().where(jobs.c.mesh_sha256 == bindparam("sha256"), jobs.c.state.in_(("queued", "running")))
)
_NEXT_REVISION = update(library_state).values(revision=library_state.c.revision + 1).returning(library_state.c.revision)
_PLACE = (
    select(shapes.c.seq, signatures.c.parameters, signatures.c.version, signatures.c.warnings)
    .join(signatures, shapes.c.signature_id == signatures.c.id)
    .where(shapes.c.id == bindparam("shape_id"))
)
_NAMED = select(shapes.c.seq, shapes.c.id, shapes.c.name, shapes.c.label).where(
    shapes.c.seq.in_(bindparam("seqs", expanding=True))
)


@dataclass(frozen=True)
class NewShape:
    """What is stored of a shape once its signature is there."""

    sha256: str
    policy: MeshPolicy
    signature: PackedSignature
    area: float
    report: dict[str, Any]
    name: str
    label: str | None
    metadata: dict[str, Any]

    @property
    def key(self) -> UploadKey:
        """What other uploads are the same by."""
        return UploadKey(self.sha256, self.signature.parameters, self.policy.to_json(), self.signature.version)


def put_mesh(connection: Connection, sha256: str, data: bytes) -> None:
    """Keep a file's bytes, once."""
    if not connection.scalar(_HAS_MESH, {"sha256": sha256}):
        connection.execute(_PUT_MESH, {"sha256": sha256, "size": len(data), "data": data})


def get_mesh(connection: Connection, sha256: str) -> bytes:
    """Return a file's bytes."""
    data = connection.scalar(_GET_MESH, {"sha256": sha256})
    if data is None:
        raise NotFoundError(f"no mesh {sha256}")
    return bytes(data)


def read_mesh_piece(connection: Connection, sha256: str, offset: int, size: int) -> bytes:
    """Return at most `size` of a file's bytes from `offset`; SQLite does not load the others."""
    if connection.dialect.name != "sqlite":
        wanted = select(func.substr(meshes.c.data, offset + 1, size)).where(meshes.c.sha256 == sha256)
        piece = connection.scalar(wanted)
    else:
        piece = _blob_piece(connection, sha256, offset, size)
    if not piece:
        raise NotFoundError(f"no mesh {sha256}")
    return bytes(piece)


def _blob_piece(connection: Connection, sha256: str, offset: int, size: int) -> bytes | None:
    row = connection.exec_driver_sql("SELECT rowid FROM meshes WHERE sha256 = ?", (sha256,)).one_or_none()
    if row is None:
        return None
    driver: Any = connection.connection.dbapi_connection
    with driver.blobopen("meshes", "data", row[0], readonly=True) as blob:
        blob.seek(offset)
        piece: bytes = blob.read(size)
        return piece


def drop_unused_mesh(connection: Connection, sha256: str) -> None:
    """Forget a file's bytes if no signature and no unfinished job needs them."""
    if not connection.scalar(_WANTED, {"sha256": sha256}):
        connection.execute(update(jobs).where(jobs.c.mesh_sha256 == sha256).values(mesh_sha256=None))
        connection.execute(delete(meshes).where(meshes.c.sha256 == sha256))
        mark_erased(connection, "soon")


def add_shape(connection: Connection, new: NewShape) -> str:
    """Store a shape whose mesh is stored already; return its id, or that of the one that has the same key."""
    known = find_shape(connection, new.key)
    if known:
        return known.id
    packed = new.signature
    _next_revision(connection)
    signature_id = connection.scalar(
        _ADD_SIGNATURE,
        {
            "mesh_sha256": new.sha256, "parameters": new.key.parameters, "policy": new.key.policy,
            "version": new.key.version, "report": new.report, "area": new.area, "stress": packed.stress,
            "payload": packed.payload, "warnings": list(packed.warnings), "dimension": packed.dimension,
        },
    )  # fmt: skip
    connection.execute(
        _ADD_DESCRIPTORS,
        [
            {"signature_id": signature_id, "measure": measure, "vector": vector}
            for measure, vector in packed.vectors.items()
        ],
    )
    shape_id = uuid.uuid4().hex
    described = {"name": new.name, "label": new.label, "metadata": new.metadata}
    now = datetime.now(UTC)
    connection.execute(
        _ADD_SHAPE, {"id": shape_id, "signature_id": signature_id, "created_at": now, "updated_at": now, **described}
    )
    return shape_id


IfKnown = Literal["keep", "update"]
"""Whether a shape that is stored already keeps its name, label and metadata, or takes those that were sent."""


@dataclass(frozen=True)
class Known:
    """A shape whose file was sent again, and which of the fields sent with it were other than the stored ones."""

    shape: ShapeRecord
    ignored: Sequence[str] = ()
    """Those that it did not take."""
    updated: Sequence[str] = ()
    """Those that it took."""


def describe_anew(connection: Connection, record: ShapeRecord, sent: Mapping[str, Any], if_known: IfKnown) -> Known:
    """Have a stored shape take what was sent with its file, or not."""
    different = {name: value for name, value in sent.items() if getattr(record, name) != value}
    if different and if_known == "update":
        return Known(change_shape(connection, record.id, different), updated=sorted(different))
    return Known(record, ignored=sorted(different))


def find_shape(connection: Connection, key: UploadKey) -> ShapeRecord | None:
    """Return the shape of this key, if there is one."""
    row = connection.execute(_FIND, vars(key)).one_or_none()
    return None if row is None else _record(row)


def get_shape(connection: Connection, shape_id: str) -> ShapeRecord:
    """Return a shape; NotFoundError if there is none of this id."""
    row = connection.execute(_GET, {"shape_id": shape_id}).one_or_none()
    if row is None:
        raise NotFoundError(f"no shape {shape_id}")
    return _record(row)


def get_signature_payload(connection: Connection, shape_id: str) -> bytes:
    """Return a shape's packed signature."""
    payload = connection.scalar(select(signatures.c.payload).select_from(_JOINED).where(shapes.c.id == shape_id))
    if payload is None:
        raise NotFoundError(f"no shape {shape_id}")
    return bytes(payload)


def get_place(connection: Connection, shape_id: str) -> tuple[int, str, str, list[str]]:
    """Return a shape's place in the order of adding, and its signature's parameters, version and warnings."""
    row = connection.execute(_PLACE, {"shape_id": shape_id}).one_or_none()
    if row is None:
        raise NotFoundError(f"no shape {shape_id}")
    return row.seq, row.parameters, row.version, row.warnings


def get_matches(connection: Connection, seqs: Sequence[int], distances: Sequence[float]) -> list[ShapeMatch]:
    """Return the shapes at these places in the order of adding, each at its distance."""
    found: dict[int, Row[Any]] = {}
    for start in range(0, len(seqs), MAX_PAGE):
        named = connection.execute(_NAMED, {"seqs": seqs[start : start + MAX_PAGE]})
        found |= {row.seq: row for row in named}
    ranked = ((found[seq], distance) for seq, distance in zip(seqs, distances, strict=True))
    return [ShapeMatch(row.id, row.name, row.label, distance) for row, distance in ranked]


def list_shapes(
    connection: Connection, *, label: str | None = None, sha256: str | None = None, cursor: str | None, limit: int
) -> ShapePage:
    """Return up to `limit` shapes after `cursor`, in the order they were added."""
    query = select(*_COLUMNS).select_from(_JOINED).order_by(shapes.c.seq).limit(min(limit, MAX_PAGE) + 1)
    if label is not None:
        query = query.where(shapes.c.label == label)
    if sha256 is not None:
        query = query.where(signatures.c.mesh_sha256 == sha256)
    if cursor is not None:
        query = query.where(shapes.c.seq > as_seq(cursor))
    rows = [_record(row) for row in connection.execute(query)]
    page = rows[: min(limit, MAX_PAGE)]
    return ShapePage(page, str(page[-1].seq) if len(rows) > len(page) else None)


def change_shape(
    connection: Connection, shape_id: str, changes: dict[str, Any], expected: Collection[int] | None = None
) -> ShapeRecord:
    """Change a shape's name, label or metadata.

    Parameters
    ----------
    connection : Connection
    shape_id : str
    changes : dict
    expected : collection of int, optional
        Revisions that may have changed it last, as far as the caller knows.

    Raises
    ------
    NotFoundError
        If there is no such shape.
    ChangedError
        If another revision changed it since.
    """
    record = _expect(connection, shape_id, expected)
    if changes:
        made = {"changed": _next_revision(connection), "updated_at": datetime.now(UTC)}
        connection.execute(update(shapes).where(shapes.c.id == shape_id).values(**changes, **made))
        if "label" in changes:
            forget_label(connection, record.label)
    return get_shape(connection, shape_id)


def remove_shape(connection: Connection, shape_id: str, expected: Collection[int] | None = None) -> None:
    """Remove a shape, its signature and descriptors, and its file unless something else needs it.

    Jobs that have ended stay, without what they say of the shape. `expected` is as in `change_shape`.
    """
    record = _expect(connection, shape_id, expected)
    signature_id = connection.scalar(select(shapes.c.signature_id).where(shapes.c.id == shape_id))
    connection.execute(delete(shapes).where(shapes.c.id == shape_id))
    connection.execute(delete(signatures).where(signatures.c.id == signature_id))
    connection.execute(update(jobs).where(jobs.c.shape_id == shape_id).values(warnings=[]))
    made = select(jobs.c.seq).where(jobs.c.shape_id == shape_id)
    connection.execute(delete(job_files).where(job_files.c.job_seq.in_(made)))
    forget_label(connection, record.label)
    drop_unused_mesh(connection, record.sha256)
    mark_erased(connection, "now")
    connection.execute(insert(removals).values(seq=record.seq, revision=_next_revision(connection)))


def _expect(connection: Connection, shape_id: str, expected: Collection[int] | None) -> ShapeRecord:
    record = get_shape(connection, shape_id)
    if expected is not None and record.changed not in expected:
        raise ChangedError(f"shape {shape_id} was changed since it was read")
    return record


def count_labels(connection: Connection) -> dict[str, int]:
    """Return how many shapes each label has, by label."""
    query = (
        select(shapes.c.label, func.count().label("size")).where(shapes.c.label.is_not(None)).group_by(shapes.c.label)
    )
    return {row.label: row.size for row in connection.execute(query.order_by(shapes.c.label))}


def count_shapes(connection: Connection) -> int:
    """Return how many shapes there are."""
    return connection.scalar(select(func.count()).select_from(shapes)) or 0


def _next_revision(connection: Connection) -> int:
    """Count a change. Before a shape is added, so that where writers wait for each other here, seqs are in order."""
    return int(connection.scalars(_NEXT_REVISION).one())


def as_seq(text: str) -> int:
    """Return where a page begins; ParameterError if the text is no cursor of a page."""
    if not text.isdecimal() or len(text) > 18:
        raise ParameterError(f"cursor {text[:40]!r} did not come from a page of this library")
    return int(text)


def _record(row: Row[*tuple[Any, ...]]) -> ShapeRecord:
    values = row._asdict()
    values |= {name: json.loads(values[name]) for name in ("parameters", "policy")}
    metadata = read_metadata(values["metadata"])
    if metadata is None:
        values["warnings"] = [*values["warnings"], _UNSHOWN]
    return ShapeRecord(**values | {"metadata": metadata or {}})
