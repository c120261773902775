"""Rows of the store as immutable values."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import datetime
from typing import Any, Literal

JobState = Literal["queued", "running", "succeeded", "failed", "cancelled"]
JobKind = Literal["shape", "query", "file"]
"""An upload, a query, or a file that is made of a stored shape."""


@dataclass(frozen=True)
class ShapeRecord:
    """A member of the library, without its arrays."""

    id: str
    name: str
    label: str | None
    metadata: dict[str, Any]
    sha256: str
    size: int
    parameters: dict[str, Any]
    policy: dict[str, Any]
    version: str
    area: float
    stress: float
    dimension: int | None
    """Effective dimension; None where the signature is of version 4 or earlier."""
    report: dict[str, Any]
    warnings: list[str]
    """Sentences that say why its signature may be wrong, and what to do."""
    created_at: datetime
    updated_at: datetime
    changed: int
    """The revision of the library that last changed it, 0 if none did."""
    seq: int


@dataclass(frozen=True)
class ShapePage:
    """Some shapes in the order they were added, and where the next page begins."""

    items: list[ShapeRecord]
    next_cursor: str | None


@dataclass(frozen=True)
class ShapeMatch:
    """A stored shape and its distance from a query."""

    id: str
    name: str
    label: str | None
    distance: float


@dataclass(frozen=True)
class JobRecord:
    """A job as the store has it."""

    id: str
    kind: JobKind
    state: JobState
    stage: str
    progress: float
    attempts: int
    restarts: int
    mesh_sha256: str | None
    file_type: str
    parameters: str
    policy: str
    request: dict[str, Any]
    error: dict[str, Any] | None
    result: dict[str, Any] | None
    shape_id: str | None
    created_at: datetime
    started_at: datetime | None
    finished_at: datetime | None
    seq: int
    warnings: list[str] = field(default_factory=list)
    """Warnings of its signature, once it has succeeded."""
    owner: str | None = None
    """The key that it was sent with; None where none was needed."""
    idempotency: str | None = None
    fingerprint: str | None = None
    ignored: list[str] = field(default_factory=list)
    """Fields of an upload that the stored shape did not take."""
    callback: str | None = None
    """The address that is told of its end."""
    callback_attempts: int = 0
    callback_due: datetime | None = None
    """When that is to be tried; None before the end, and when it was told or given up."""
    detail: dict[str, float] = field(default_factory=dict)
    """What the stage tells of itself while the job runs; not stored."""

    @property
    def finished(self) -> bool:
        """Whether the state will not change any more."""
        return self.state in {"succeeded", "failed", "cancelled"}


@dataclass(frozen=True)
class JobPage:
    """Some jobs without their results, the newest first, and where the next page begins."""

    items: list[JobRecord]
    next_cursor: str | None


@dataclass(frozen=True)
class JobFile:
    """What a job of the kind "file" made."""

    file_type: str
    name: str
    data: bytes
