"""Rows of shapes, their meshes, signatures and descriptors: reads and writes within the caller's transaction."""

from __future__ import annotations

import uuid
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Final, Self

import numpy as np
from sqlalchemy import Connection, String, bindparam, cast, delete, exists, func, insert, select, update
from sqlalchemy.engine import Row

from unbend.arrays import Floats
from unbend.brief import assigned, brief, noted
from unbend.errors import ChangedError, NotFoundError, ParameterError
from unbend.library.metadata import read_metadata
from unbend.library.packing import PackedSignature, unpack_local, unpack_signature
from unbend.library.requests import ShapeRequest, UploadKey, decode_parameters, decode_policy
from unbend.library.storage.log_eraser import mark_erased
from unbend.library.storage.object_rows import queue_deletion
from unbend.library.storage.postgres import lock
from unbend.library.storage.schema import (
    descriptors,
    job_files,
    jobs,
    library_state,
    local_signatures,
    meshes,
    removals,
    shapes,
    signatures,
)
from unbend.library.stored_rankings import delete_unused_label
from unbend.library.vector_rows import add_vectors
from unbend.local.signatures import LOCAL_VERSION, LocalSignatures
from unbend.results.jobs import UNFINISHED_STATES
from unbend.results.rankings import ShapeMatch
from unbend.results.shapes import AddedShape, ShapeOrder, ShapePage, ShapeRecord
from unbend.signature.from_file import FileSignature
from unbend.signature.signature import Signature

MAX_PAGE = 500

# Read as text, because an earlier version may have stored metadata that is nested too deeply to parse.
_METADATA = cast(shapes.c.metadata, String).label("metadata")
_TOO_DEEP: Final = "the metadata is nested too deeply to be shown: set it again"
_COLUMNS = (
    shapes.c.id, shapes.c.name, shapes.c.label, _METADATA, meshes.c.sha256, meshes.c.size,
    signatures.c.parameters, signatures.c.policy, signatures.c.version, signatures.c.area, signatures.c.stress,
    signatures.c.dimension, signatures.c.report, signatures.c.warnings, shapes.c.created_at,
    shapes.c.updated_at, shapes.c.changed.label("revision"), shapes.c.seq,
)  # fmt: skip
_JOINED = shapes.join(signatures, shapes.c.signature_id == signatures.c.id).join(
    meshes, signatures.c.mesh_sha256 == meshes.c.sha256
)
# Built once: building a statement costs more than running it.
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
# Not by RETURNING, which SQLite 3.40 evaluates wrongly for IS NULL after the deletion.
_IS_ELSEWHERE = select(meshes.c.data.is_(None)).where(meshes.c.sha256 == bindparam("sha256"))
_LOCK_MESH = _IS_ELSEWHERE.with_for_update()
_PUT_MESH, _ADD_DESCRIPTORS, _ADD_SHAPE = insert(meshes), insert(descriptors), insert(shapes)
_ADD_LOCAL = insert(local_signatures)
_ADD_SIGNATURE = insert(signatures).returning(signatures.c.id)
_IS_MESH_NEEDED = select(
    exists().where(signatures.c.mesh_sha256 == bindparam("sha256"))
    | exists().where(jobs.c.mesh_sha256 == bindparam("sha256"), jobs.c.state.in_(UNFINISHED_STATES))
)
_NEXT_REVISION = update(library_state).values(revision=library_state.c.revision + 1).returning(library_state.c.revision)
_GET_PLACE = (
    select(shapes.c.seq, signatures.c.parameters, signatures.c.version, signatures.c.warnings)
    .join(signatures, shapes.c.signature_id == signatures.c.id)
    .where(shapes.c.id == bindparam("shape_id"))
)
_GET_PAYLOAD = (
    select(signatures.c.id, signatures.c.payload).select_from(_JOINED).where(shapes.c.id == bindparam("shape_id"))
)
_GET_DESCRIPTORS = select(descriptors.c.measure, descriptors.c.vector).where(
    descriptors.c.signature_id == bindparam("signature_id")
)
_GET_BOUNDARIES = (
    select(shapes.c.seq, signatures.c.boundary)
    .join(signatures, shapes.c.signature_id == signatures.c.id)
    .where(shapes.c.seq.in_(bindparam("seqs", expanding=True)))
)
_GET_LOCALS = (
    select(shapes.c.seq, local_signatures.c.payload)
    .join(local_signatures, local_signatures.c.signature_id == shapes.c.signature_id)
    .where(shapes.c.seq.in_(bindparam("seqs", expanding=True)), local_signatures.c.version == bindparam("version"))
)
_WITHOUT_LOCAL = (
    select(*_COLUMNS)
    .select_from(_JOINED)
    .where(
        ~exists().where(
            local_signatures.c.signature_id == signatures.c.id, local_signatures.c.version == bindparam("version")
        )
    )
    .order_by(shapes.c.seq)
)
_GET_NAMES = select(shapes.c.seq, shapes.c.id, shapes.c.name, shapes.c.label).where(
    shapes.c.seq.in_(bindparam("seqs", expanding=True))
)


@dataclass(frozen=True)
class ComputedShape:
    """The results of reading and computing an upload."""

    key: UploadKey
    signature: PackedSignature
    area: float
    report: Mapping[str, Any]

    def __repr__(self) -> str:
        chosen = decode_parameters(self.key.parameters)
        return brief(
            self, f"mesh {self.key.sha256[:8]}", *assigned({"samples": chosen.samples}),
            f"version {self.key.version}", noted(len(self.signature.warnings), "warning"),
        )  # fmt: skip

    @classmethod
    def of(cls, key: UploadKey, found: FileSignature) -> Self:
        """Return what the store has of a file with this key."""
        return cls(key, PackedSignature.of(found.signature), found.surface.area, found.surface.report.as_dict())


def put_mesh(connection: Connection, sha256: str, data: bytes) -> None:
    """Store a file's bytes unless they are stored already."""
    if not connection.scalar(_HAS_MESH, {"sha256": sha256}):
        connection.execute(_PUT_MESH, {"sha256": sha256, "size": len(data), "data": data})


def get_file(connection: Connection, sha256: str) -> bytes | None:
    """Return a file's bytes, None if the object store has them; NotFoundError if there is no such file."""
    row = connection.execute(_GET_MESH, {"sha256": sha256}).one_or_none()
    if row is None:
        raise NotFoundError(f"no mesh {sha256}")
    return None if row.data is None else bytes(row.data)


def read_file_range(connection: Connection, sha256: str, offset: int, size: int) -> bytes | None:
    """Return at most `size` of a file's bytes from `offset`, None if the object store has them; it reads only these.

    Raises
    ------
    NotFoundError
        If there is no such file.
    """
    is_elsewhere = connection.scalar(_IS_ELSEWHERE, {"sha256": sha256})
    if is_elsewhere is None:
        raise NotFoundError(f"no mesh {sha256}")
    if is_elsewhere:
        return None
    if connection.dialect.name == "sqlite":
        return _read_blob_range(connection, sha256, offset, size)
    wanted = select(func.substr(meshes.c.data, offset + 1, size)).where(meshes.c.sha256 == sha256)
    return bytes(connection.execute(wanted).scalar_one())


def _read_blob_range(connection: Connection, sha256: str, offset: int, size: int) -> bytes:
    row = connection.exec_driver_sql("SELECT rowid FROM meshes WHERE sha256 = ?", (sha256,)).one()
    driver: Any = connection.connection.dbapi_connection
    with driver.blobopen("meshes", "data", row[0], readonly=True) as blob:
        blob.seek(offset)
        piece: bytes = blob.read(size)
        return piece


def delete_unused_mesh(connection: Connection, sha256: str) -> None:
    """Delete a file's bytes if no signature and no unfinished job needs them; queue the deletion of its object."""
    if not connection.scalar(_IS_MESH_NEEDED, {"sha256": sha256}):
        connection.execute(update(jobs).where(jobs.c.mesh_sha256 == sha256).values(mesh_sha256=None))
        is_elsewhere = connection.scalar(_LOCK_MESH, {"sha256": sha256})
        connection.execute(delete(meshes).where(meshes.c.sha256 == sha256))
        if is_elsewhere:
            queue_deletion(connection, sha256)
        mark_erased(connection, "soon")


def add_shape(connection: Connection, computed: ComputedShape, request: ShapeRequest) -> ShapeRecord:
    """Store a shape whose mesh is stored already; return the new shape, or the stored shape with the same key."""
    lock_shapes(connection)
    known = find_shape(connection, computed.key)
    if known:
        return known
    key, packed = computed.key, computed.signature
    _next_revision(connection)
    signature_id = connection.scalar(
        _ADD_SIGNATURE,
        {
            "mesh_sha256": key.sha256, "parameters": key.parameters, "policy": key.policy, "version": key.version,
            "report": computed.report, "area": computed.area, "stress": packed.stress, "payload": packed.payload,
            "warnings": list(packed.warnings), "dimension": packed.dimension, "boundary": packed.boundary,
        },
    )  # fmt: skip
    connection.execute(
        _ADD_DESCRIPTORS,
        [
            {"signature_id": signature_id, "measure": measure, "vector": vector}
            for measure, vector in packed.vectors.items()
        ],
    )
    if packed.local:
        connection.execute(
            _ADD_LOCAL, {"signature_id": signature_id, "version": LOCAL_VERSION, "payload": packed.local}
        )
    shape_id, now = uuid.uuid4().hex, datetime.now(UTC)
    described = {"name": request.name, "label": request.label, "metadata": dict(request.metadata)}
    connection.execute(
        _ADD_SHAPE, {"id": shape_id, "signature_id": signature_id, "created_at": now, "updated_at": now, **described}
    )
    added = get_shape(connection, shape_id)
    add_vectors(connection, added.seq, key.parameters, key.version, packed.vectors)
    return added


def update_known(connection: Connection, shape: ShapeRecord, request: ShapeRequest) -> AddedShape:
    """Change a known shape as `request` describes if its `if_known` is "update"; return what changed."""
    different = find_differences(shape, request)
    if different and request.if_known == "update":
        changed = change_shape(connection, shape.id, different)
        return AddedShape.of(changed, is_new=False, updated=sorted(different))
    return AddedShape.of(shape, is_new=False, ignored=sorted(different))


def find_differences(shape: ShapeRecord, request: ShapeRequest) -> dict[str, Any]:
    """Return the fields that `request` gives, where the shape has other values."""
    return {name: value for name, value in request.changes.items() if getattr(shape, name) != value}


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


def get_signature(connection: Connection, shape_id: str) -> Signature:
    """Return a shape's signature; NotFoundError if there is no such shape."""
    row = connection.execute(_GET_PAYLOAD, {"shape_id": shape_id}).one_or_none()
    if row is None:
        raise NotFoundError(f"no shape {shape_id}")
    vectors = connection.execute(_GET_DESCRIPTORS, {"signature_id": row.id})
    return unpack_signature(row.payload, {each.measure: each.vector for each in vectors})


def get_descriptors(connection: Connection, seq: int) -> dict[str, Floats]:
    """Return the descriptors of the shape at a place in the order of adding."""
    signature_id = connection.scalar(select(shapes.c.signature_id).where(shapes.c.seq == seq))
    rows = connection.execute(_GET_DESCRIPTORS, {"signature_id": signature_id})
    return {row.measure: np.frombuffer(row.vector, "<f8") for row in rows}


def get_boundaries(connection: Connection, seqs: Sequence[int]) -> list[float | None]:
    """Return the lengths of boundaries of the shapes at these places in the order of adding; None if unknown."""
    found = {row.seq: row.boundary for row in connection.execute(_GET_BOUNDARIES, {"seqs": seqs})}
    return [found.get(seq) for seq in seqs]


def get_locals(connection: Connection, seqs: Sequence[int]) -> dict[int, LocalSignatures]:
    """Return the local signatures of the shapes at these places in the order of adding, where there are any."""
    found: dict[int, LocalSignatures] = {}
    for start in range(0, len(seqs), MAX_PAGE):
        stored = connection.execute(_GET_LOCALS, {"seqs": seqs[start : start + MAX_PAGE], "version": LOCAL_VERSION})
        found |= {row.seq: unpack_local(row.payload) for row in stored}
    return found


def list_without_local(connection: Connection) -> list[ShapeRecord]:
    """Return the shapes that have no local signatures of this version, in the order of adding."""
    return [_record(row) for row in connection.execute(_WITHOUT_LOCAL, {"version": LOCAL_VERSION})]


def put_local(connection: Connection, shape_id: str, payload: bytes) -> None:
    """Store the local signatures of a shape instead of earlier ones; do nothing if the shape was removed."""
    lock_shapes(connection)
    signature_id = connection.scalar(select(shapes.c.signature_id).where(shapes.c.id == shape_id))
    if signature_id is not None:
        connection.execute(delete(local_signatures).where(local_signatures.c.signature_id == signature_id))
        connection.execute(_ADD_LOCAL, {"signature_id": signature_id, "version": LOCAL_VERSION, "payload": payload})
        _next_revision(connection)


def get_place(connection: Connection, shape_id: str) -> tuple[int, str, str, list[str]]:
    """Return a shape's place in the order of adding, and the parameters, version and warnings of its signature."""
    row = connection.execute(_GET_PLACE, {"shape_id": shape_id}).one_or_none()
    if row is None:
        raise NotFoundError(f"no shape {shape_id}")
    return row.seq, row.parameters, row.version, row.warnings


def get_matches(connection: Connection, seqs: Sequence[int], distances: Sequence[float]) -> list[ShapeMatch]:
    """Return the shapes at these places in the order of adding, with their distances."""
    found: dict[int, Row[Any]] = {}
    for start in range(0, len(seqs), MAX_PAGE):
        named = connection.execute(_GET_NAMES, {"seqs": seqs[start : start + MAX_PAGE]})
        found |= {row.seq: row for row in named}
    ranked = ((found[seq], distance) for seq, distance in zip(seqs, distances, strict=True))
    return [ShapeMatch(row.id, row.name, row.label, distance) for row, distance in ranked]


def list_shapes(
    connection: Connection,
    *,
    label: str | None = None,
    sha256: str | None = None,
    name: str | None = None,
    order: ShapeOrder = "oldest",
    cursor: str | None,
    limit: int,
) -> ShapePage:
    """Return up to `limit` shapes after `cursor`, in the order they were added, or in reverse."""
    place = shapes.c.seq if order == "oldest" else shapes.c.seq.desc()
    query = select(*_COLUMNS).select_from(_JOINED).order_by(place).limit(min(limit, MAX_PAGE) + 1)
    if name is not None:
        query = query.where(shapes.c.name.icontains(name, autoescape=True))
    if label is not None:
        query = query.where(shapes.c.label == label)
    if sha256 is not None:
        query = query.where(signatures.c.mesh_sha256 == sha256)
    if cursor is not None:
        last = parse_cursor(cursor)
        query = query.where(shapes.c.seq > last if order == "oldest" else shapes.c.seq < last)
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
        The shape's last revision must be one of these.

    Raises
    ------
    NotFoundError
        If there is no such shape.
    ChangedError
        If the shape's last revision is not one of `expected`.
    """
    lock_shapes(connection)
    record = _expect(connection, shape_id, expected)
    if changes:
        made = {"changed": _next_revision(connection), "updated_at": datetime.now(UTC)}
        connection.execute(update(shapes).where(shapes.c.id == shape_id).values(**changes, **made))
        if "label" in changes:
            delete_unused_label(connection, record.label)
    return get_shape(connection, shape_id)


def remove_shape(connection: Connection, shape_id: str, expected: Collection[int] | None = None) -> None:
    """Remove a shape, its signature and descriptors, and its file unless something else needs it.

    Its jobs stay, without their files and without the warnings about the shape. `expected` is as in `change_shape`.
    """
    lock_shapes(connection)
    record = _expect(connection, shape_id, expected)
    signature_id = connection.scalar(select(shapes.c.signature_id).where(shapes.c.id == shape_id))
    connection.execute(delete(shapes).where(shapes.c.id == shape_id))
    connection.execute(delete(signatures).where(signatures.c.id == signature_id))
    connection.execute(update(jobs).where(jobs.c.shape_id == shape_id).values(warnings=[]))
    made = select(jobs.c.seq).where(jobs.c.shape_id == shape_id)
    connection.execute(delete(job_files).where(job_files.c.job_seq.in_(made)))
    delete_unused_label(connection, record.label)
    delete_unused_mesh(connection, record.sha256)
    mark_erased(connection, "now")
    connection.execute(insert(removals).values(seq=record.seq, revision=_next_revision(connection)))


def _expect(connection: Connection, shape_id: str, expected: Collection[int] | None) -> ShapeRecord:
    record = get_shape(connection, shape_id)
    if expected is not None and record.revision not in expected:
        raise ChangedError(f"shape {shape_id} was changed since it was read")
    return record


def count_labels(connection: Connection) -> dict[str, int]:
    """Return the number of shapes of each label."""
    query = (
        select(shapes.c.label, func.count().label("size")).where(shapes.c.label.is_not(None)).group_by(shapes.c.label)
    )
    # Sorted here, because databases sort letters in different orders.
    return dict(sorted((row.label, row.size) for row in connection.execute(query)))


def count_shapes(connection: Connection) -> int:
    """Return the number of shapes."""
    return connection.scalar(select(func.count()).select_from(shapes)) or 0


def lock_shapes(connection: Connection) -> None:
    """Let no other transaction add, change or remove shapes before this one ends.

    Shapes thereby appear in the order of their seqs, and nothing changes between a check and the write that relies on
    it. To avoid deadlocks, call this before the transaction locks a job.
    """
    lock(connection, "shapes")


def _next_revision(connection: Connection) -> int:
    """Increment the revision and return it."""
    return int(connection.scalars(_NEXT_REVISION).one())


def parse_cursor(text: str) -> int:
    """Return the seq in a page's cursor; ParameterError if the text is not a cursor."""
    if not text.isdecimal() or len(text) > 18:
        raise ParameterError(f"cursor {text[:40]!r} is not the next_cursor of a page")
    return int(text)


def _record(row: Row[*tuple[Any, ...]]) -> ShapeRecord:
    values = row._asdict()
    values |= {"parameters": decode_parameters(row.parameters), "policy": decode_policy(row.policy)}
    metadata = read_metadata(values["metadata"])
    if metadata is None:
        values["warnings"] = [*values["warnings"], _TOO_DEEP]
    return ShapeRecord(**values | {"metadata": metadata or {}})
