"""Records of the library as immutable values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any

from unbend.library.requests import JobRequest
from unbend.mesh.policy import MeshPolicy
from unbend.results.jobs import ENDED_STATES, JobFailure, JobKind, JobState, JobStatus
from unbend.results.rankings import Ranking
from unbend.signature.parameters import Parameters


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
    ticket: int | None = None
    """The delivery of a cluster's queue by which a worker claimed the job; None in a library with one server."""
    detail: Mapping[str, float] = field(default_factory=dict)
    """Details of the present stage while the job runs; not stored."""

    @property
    def finished(self) -> bool:
        """Whether the state is final."""
        return self.state in ENDED_STATES

    def status(self, position: int | None = None) -> JobStatus:
        """Return what the owner of the job may know."""
        return JobStatus(
            self.id, self.kind, self.state, self.stage, self.progress, self.detail, position, self.attempts,
            JobFailure(**self.error) if self.error else None, self.shape_id, tuple(self.warnings), tuple(self.ignored),
            self.created_at, self.started_at, self.finished_at,
            Ranking.from_dict(self.result) if self.result else None,
        )  # fmt: skip


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
