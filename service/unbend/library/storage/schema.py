"""The tables of the store. Migrations create the tables and comments; a test checks that both definitions agree."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

from sqlalchemy import (
    JSON,
    BigInteger,
    Column,
    Dialect,
    Float,
    ForeignKey,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    String,
    Table,
    TypeDecorator,
    UniqueConstraint,
)

metadata = MetaData(
    naming_convention={
        "ix": "ix_%(table_name)s_%(column_0_N_name)s",
        "uq": "uq_%(table_name)s_%(column_0_N_name)s",
        "fk": "fk_%(table_name)s_%(column_0_name)s",
        "pk": "pk_%(table_name)s",
    }
)


class Instant(TypeDecorator[datetime]):
    """A UTC time, stored as seconds since 1970, which every database sorts and compares alike."""

    impl = Float
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: Dialect) -> float | None:  # noqa: ARG002
        """Convert to seconds."""
        return None if value is None else value.timestamp()

    def process_result_value(self, value: Any, dialect: Dialect) -> datetime | None:  # noqa: ARG002
        """Convert from seconds."""
        return None if value is None else datetime.fromtimestamp(value, UTC)


Serial = BigInteger().with_variant(Integer, "sqlite")
"""A number that grows for ever. In SQLite every integer has 64 bits, and only the type Integer counts by itself."""

meshes = Table(
    "meshes",
    metadata,
    Column("sha256", String(64), primary_key=True),
    Column("size", Integer, nullable=False),
    Column("data", LargeBinary),
    comment="Uploaded files, byte for byte; one row however often a file is sent. "
    "data is null if the object store has it.",
)

object_writes = Table(
    "object_writes",
    metadata,
    Column("token", String(32), primary_key=True),
    Column("sha256", String(64), nullable=False),
    Column("at", Instant, nullable=False),
    Index(None, "sha256"),
    Index(None, "at"),
    comment="Objects that are written now; the transaction that needs an object removes its row.",
)

object_deletions = Table(
    "object_deletions",
    metadata,
    Column("sha256", String(64), primary_key=True),
    Column("at", Instant, nullable=False),
    Column("claim", String(32)),
    Column("claimed_at", Instant),
    comment="Objects that no mesh needs. A claimed deletion is carried out now, and no write of the object begins.",
)

signatures = Table(
    "signatures",
    metadata,
    Column("id", Integer, primary_key=True),
    Column("mesh_sha256", ForeignKey("meshes.sha256"), nullable=False),
    Column("parameters", String, nullable=False),
    Column("policy", String, nullable=False),
    Column("version", String, nullable=False),
    Column("report", JSON, nullable=False),
    Column("area", Float, nullable=False),
    Column("stress", Float, nullable=False),
    Column("payload", LargeBinary, nullable=False),
    Column("warnings", JSON, nullable=False, server_default="[]"),
    Column("dimension", Integer),
    Column("boundary", Float),
    UniqueConstraint("mesh_sha256", "parameters", "policy", "version"),
    comment="What was computed: one row for a file, parameters, reading policy and version of the algorithm.",
)

descriptors = Table(
    "descriptors",
    metadata,
    Column("signature_id", ForeignKey("signatures.id", ondelete="CASCADE"), primary_key=True),
    Column("measure", String, primary_key=True),
    Column("vector", LargeBinary, nullable=False),
    comment="Vectors for comparing, little-endian float64.",
)

local_signatures = Table(
    "local_signatures",
    metadata,
    Column("signature_id", ForeignKey("signatures.id", ondelete="CASCADE"), primary_key=True),
    Column("version", String, nullable=False),
    Column("payload", LargeBinary, nullable=False),
    comment="Local signatures, by which pieces are recognised; shapes of earlier versions have none.",
)

shapes = Table(
    "shapes",
    metadata,
    Column("seq", Integer, primary_key=True, autoincrement=True),
    Column("id", String(32), nullable=False, unique=True),
    Column("name", String, nullable=False),
    Column("label", String),
    Column("metadata", JSON, nullable=False),
    Column("signature_id", ForeignKey("signatures.id"), nullable=False, unique=True),
    Column("created_at", Instant, nullable=False),
    Column("changed", Integer, nullable=False, server_default="0"),
    Column("updated_at", Instant, nullable=False, server_default="0"),
    Index(None, "label", "seq"),
    Index(None, "changed"),
    sqlite_autoincrement=True,
    comment="The library's members. seq never comes again, so that pages and the search index can rely on it; "
    "changed is the revision that last changed a row since it was added.",
)

labels = Table(
    "labels",
    metadata,
    Column("id", Integer, primary_key=True, autoincrement=True),
    Column("text", String, nullable=False, unique=True),
    sqlite_autoincrement=True,
    comment="Classes that stored answers name; each goes with its last member.",
)

removals = Table(
    "removals",
    metadata,
    Column("seq", Integer, primary_key=True, autoincrement=False),
    Column("revision", Integer, nullable=False),
    Index(None, "revision"),
    comment="Shapes that are gone, and the revision that removed them.",
)

jobs = Table(
    "jobs",
    metadata,
    Column("seq", Serial, primary_key=True, autoincrement=True),
    Column("id", String(32), nullable=False, unique=True),
    Column("kind", String, nullable=False),
    Column("state", String, nullable=False),
    Column("stage", String, nullable=False),
    Column("progress", Float, nullable=False),
    Column("attempts", Integer, nullable=False),
    Column("restarts", Integer, nullable=False),
    Column("mesh_sha256", ForeignKey("meshes.sha256")),
    Column("file_type", String, nullable=False),
    Column("parameters", String, nullable=False),
    Column("policy", String, nullable=False),
    Column("request", JSON, nullable=False),
    Column("error", JSON),
    Column("result", JSON),
    Column("shape_id", String(32)),
    Column("created_at", Instant, nullable=False),
    Column("started_at", Instant),
    Column("finished_at", Instant),
    Column("warnings", JSON, nullable=False, server_default="[]"),
    Column("owner", String(12)),
    Column("idempotency", String(64)),
    Column("fingerprint", String(64)),
    Column("ignored", JSON, nullable=False, server_default="[]"),
    Column("callback", String),
    Column("callback_attempts", Integer, nullable=False, server_default="0"),
    Column("callback_due", Instant),
    Column("ticket", BigInteger),
    Index(None, "state", "seq"),
    Index(None, "state", "owner", "seq"),
    Index(None, "idempotency"),
    Index(None, "callback_due"),
    Index(None, "mesh_sha256"),
    Index(None, "shape_id"),
    Index(None, "finished_at"),
    sqlite_autoincrement=True,
    comment="The queue and its history. ticket is the delivery of a cluster's queue by which a worker claimed the job.",
)

job_files = Table(
    "job_files",
    metadata,
    Column("job_seq", ForeignKey("jobs.seq", ondelete="CASCADE"), primary_key=True),
    Column("file_type", String, nullable=False),
    Column("name", String, nullable=False),
    Column("data", LargeBinary, nullable=False),
    comment="What jobs of the kind file made; kept for a day.",
)

library_state = Table(
    "library_state",
    metadata,
    Column("id", Integer, primary_key=True),
    Column("revision", Integer, nullable=False),
    Column("epoch", String(32), nullable=False, server_default="0"),
    comment="One row; revision counts changes to shapes within an epoch, which a restore begins, so that caches know.",
)

api_keys = Table(
    "api_keys",
    metadata,
    Column("id", String(12), primary_key=True),
    Column("name", String, nullable=False),
    Column("scope", String, nullable=False),
    Column("sha256", String(64), nullable=False),
    Column("created_at", Instant, nullable=False),
    Column("revoked_at", Instant),
    Column("expires_at", Instant),
    Column("most_jobs", Integer),
    comment="Who may call the service; of a secret only its hash is here.",
)
