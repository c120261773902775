"""Jobs of a service or a library."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any, Final, Literal, Self

from unbend.brief import assigned, brief, changed
from unbend.results.decoding import instant, known_fields
from unbend.results.rankings import Ranking

JobKind = Literal["shape", "query", "file"]
"""An upload, a query, or the making of a file from a stored shape."""

JobState = Literal["queued", "running", "succeeded", "failed", "cancelled"]

ENDED_STATES: Final[tuple[JobState, ...]] = ("succeeded", "failed", "cancelled")
UNFINISHED_STATES: Final[tuple[JobState, ...]] = ("queued", "running")


@dataclass(frozen=True)
class JobFailure:
    """The error of a job that failed or was cancelled."""

    code: str
    message: str
    advice: str = ""


@dataclass(frozen=True)
class JobStatus:
    """A job: queued, running, and finally succeeded, failed or cancelled."""

    id: str
    """Empty for an upload whose shape was stored already: it needs no job."""
    kind: JobKind
    state: JobState
    stage: str = ""
    progress: float = 0.0
    """Share of the work that is done, 0 to 1."""
    detail: Mapping[str, float] = field(default_factory=dict)
    """Details of the running stage, such as `row` of `rows`, and `seconds` since the start of the job."""
    position: int | None = None
    """Number of jobs before this one in the queue; None once it runs."""
    attempts: int = 0
    """Number of attempts. A job whose process died is attempted again."""
    error: JobFailure | None = None
    shape_id: str | None = None
    """The shape of a succeeded upload, or the shape of which the job makes a file."""
    warnings: Sequence[str] = ()
    """Reasons why the result may be wrong, and what to do."""
    ignored: Sequence[str] = ()
    """Fields of an upload that the stored shape did not take."""
    created_at: datetime | None = None
    started_at: datetime | None = None
    finished_at: datetime | None = None
    result: Ranking | None = None
    """The ranking of a succeeded query."""

    def __repr__(self) -> str:
        return brief(self, *assigned(changed(self)))

    @property
    def finished(self) -> bool:
        """Whether the state is final."""
        return self.state in ENDED_STATES

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """Return the job of a response of the service."""
        error, result = values.get("error"), values.get("result")
        return cls(
            **known_fields(cls, values)
            | {
                "error": JobFailure(**known_fields(JobFailure, error)) if error else None,
                "warnings": tuple(values.get("warnings", ())),
                "ignored": tuple(values.get("ignored", ())),
                "result": Ranking.from_dict(result) if result else None,
            }
            | {name: instant(values.get(name)) for name in ("created_at", "started_at", "finished_at")}
        )

    def as_dict(self) -> dict[str, Any]:
        """Return the job as JSON values, in the form of the HTTP contract."""
        times = {name: getattr(self, name) for name in ("created_at", "started_at", "finished_at")}
        return {
            **vars(self),
            "detail": dict(self.detail),
            "error": dict(vars(self.error)) if self.error else None,
            "warnings": list(self.warnings),
            "ignored": list(self.ignored),
            "result": self.result.as_dict() if self.result else None,
            **{name: time and time.isoformat() for name, time in times.items()},
        }
