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
    """The revision of the library that last changed it, 0 if none did."""
    seq: int
    """Its place in the order of adding."""

    @property
    def file_type(self) -> str:
        """The format of its file."""
        return str(self.report["file_type"])


@dataclass(frozen=True)
class KnownShape:
    """A stored shape whose file was sent again."""

    shape: ShapeRecord
    ignored: Sequence[str] = ()
    """Fields sent with it that differ from the stored ones and were not taken: of "name", "label", "metadata"."""
    updated: Sequence[str] = ()
    """Fields sent with it that differed from the stored ones and were taken."""


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
    """Warnings about its signature, once it has succeeded."""
    owner: str | None = None
    """The id of the API key that sent it; None if the library needs no keys."""
    idempotency: str | None = None
    fingerprint: str | None = None
    ignored: list[str] = field(default_factory=list)
    """Fields of an upload that the stored shape did not take."""
    callback: str | None = None
    """The URL of the webhook that reports its end."""
    callback_attempts: int = 0
    callback_due: datetime | None = None
    """Time of the next attempt; None before the job ends, and after the webhook succeeded or was given up."""
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
