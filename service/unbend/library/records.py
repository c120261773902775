"""Records of the library as immutable values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any, Final, Literal

from unbend.library.requests import JobKind, JobRequest
from unbend.mesh.policy import MeshPolicy
from unbend.signature.parameters import Parameters

JobState = Literal["queued", "running", "succeeded", "failed", "cancelled"]

ENDED_STATES: Final[tuple[JobState, ...]] = ("succeeded", "failed", "cancelled")
UNFINISHED_STATES: Final[tuple[JobState, ...]] = ("queued", "running")


@dataclass(frozen=True)
class ShapeRecord:
    """A member of the library, without its arrays."""

    id: str
    name: str
    label: str | None
    metadata: dict[str, Any]
    sha256: str
    size: int
    parameters: Parameters
    policy: MeshPolicy
    version: str
    area: float
    stress: float
    dimension: int | None
    """Effective dimension; None for signatures of version 4 or earlier."""
    report: dict[str, Any]
    warnings: list[str]
    """Reasons why the signature may be wrong, and what to do."""
    created_at: datetime
    updated_at: datetime
    changed: int
    """The revision of the library that last changed the shape; 0 if it was never changed."""
    seq: int
    """The shape's place in the order of adding."""

    @property
    def file_type(self) -> str:
        """The format of the uploaded file."""
        return str(self.report["file_type"])


@dataclass(frozen=True)
class KnownShape:
    """A stored shape whose file was sent again."""

    shape: ShapeRecord
    ignored: Sequence[str] = ()
    """Fields of "name", "label" and "metadata" that were sent with other values, and that the shape did not take."""
    updated: Sequence[str] = ()
    """Fields that were sent with other values, and that the shape took."""


@dataclass(frozen=True)
class Received(KnownShape):
    """A stored shape, and whether it is new."""

    is_new: bool = False
    """Whether this call stored the shape."""


@dataclass(frozen=True)
class ShapePage:
    """A page of shapes in the order of adding, and the cursor of the next page."""

    items: list[ShapeRecord]
    next_cursor: str | None


@dataclass(frozen=True)
class ShapeMatch:
    """A stored shape and its distance from a query."""

    id: str
    name: str
    label: str | None
    distance: float
    part: Mapping[str, Any] | None = None
    """How the query relates to the shape, under a measure of parts: see `Comparison.as_dict`."""

    def as_dict(self) -> dict[str, Any]:
        """Return the match as JSON values."""
        return dict(vars(self)) | {"part": dict(self.part) if self.part else None}


@dataclass(frozen=True)
class JobRecord:
    """A job as it is stored."""

    id: str
    kind: JobKind
    state: JobState
    stage: str
    progress: float
    attempts: int
    restarts: int
    mesh_sha256: str | None
    file_type: str
    parameters: Parameters
    policy: MeshPolicy
    request: JobRequest | None
    """None once the job has ended."""
    error: dict[str, Any] | None
    result: dict[str, Any] | None
    shape_id: str | None
    created_at: datetime
    started_at: datetime | None
    finished_at: datetime | None
    seq: int
    warnings: list[str] = field(default_factory=list)
    """Warnings about the signature, once the job has succeeded."""
    owner: str | None = None
    """The id of the API key that sent the job; None if the library needs no keys."""
    idempotency: str | None = None
    fingerprint: str | None = None
    ignored: list[str] = field(default_factory=list)
    """Fields of an upload that the stored shape did not take."""
    callback: str | None = None
    """The URL of the webhook that reports the job's end."""
    callback_attempts: int = 0
    callback_due: datetime | None = None
    """Time of the webhook's next attempt; None before the job ends, and after the last attempt."""
    detail: Mapping[str, float] = field(default_factory=dict)
    """Details of the present stage while the job runs; not stored."""

    @property
    def finished(self) -> bool:
        """Whether the state is final."""
        return self.state in ENDED_STATES


@dataclass(frozen=True)
class JobPage:
    """A page of jobs without results, the newest first, and the cursor of the next page."""

    items: list[JobRecord]
    next_cursor: str | None


@dataclass(frozen=True)
class JobFile:
    """The file that a job of the kind "file" made."""

    file_type: str
    name: str
    data: bytes
