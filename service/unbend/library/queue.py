"""The durable queue: rows of `jobs` and the moves between their states."""

from __future__ import annotations

import uuid
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any, Literal

from sqlalchemy import Connection, bindparam, func, insert, select, update
from sqlalchemy.engine import Row

from unbend.errors import NotFoundError
from unbend.library.forgetting import without_gone
from unbend.library.key import UploadKey
from unbend.library.records import JobKind, JobRecord, JobState
from unbend.library.schema import Instant, jobs
from unbend.library.shapes import drop_unused_mesh

Lost = Literal["worker", "server", "nothing"]
"""Why a job is given back: its process died, the whole server died, or the server stops in order."""

# Made once: to make a statement costs more than to run it.
_UNFINISHED = jobs.c.state.in_(("queued", "running"))
_ENQUEUE = insert(jobs).returning(*jobs.c)
_GET = select(jobs).where(jobs.c.id == bindparam("job_id"))
_ACTIVE = (
    select(jobs)
    .where(
        jobs.c.kind == bindparam("kind"),
        jobs.c.mesh_sha256 == bindparam("sha256"),
        jobs.c.parameters == bindparam("parameters"),
        jobs.c.policy == bindparam("policy"),
        _UNFINISHED,
    )
    .limit(1)
)
_COUNT = select(func.count()).select_from(jobs).where(jobs.c.state == "queued")
_COUNT_BEFORE = _COUNT.where(jobs.c.seq < bindparam("before"))
_OLDEST = select(jobs.c.seq).where(jobs.c.state == "queued").order_by(jobs.c.seq).limit(1).scalar_subquery()
_CLAIM = (
    update(jobs)
    .where(jobs.c.seq == _OLDEST, jobs.c.state == "queued")
    .values(
        state="running", stage="starting", attempts=jobs.c.attempts + 1, started_at=bindparam("now", type_=Instant())
    )
    .returning(*jobs.c)
)
_FINISH = update(jobs).where(jobs.c.id == bindparam("job_id"), _UNFINISHED).returning(*jobs.c)


def enqueue(
    connection: Connection, *, kind: JobKind, key: UploadKey, file_type: str, request: dict[str, Any]
) -> JobRecord:
    """Append a job whose mesh is stored already."""
    row = connection.execute(
        _ENQUEUE,
        {
            "id": uuid.uuid4().hex, "kind": kind, "state": "queued", "stage": "queued", "progress": 0.0,
            "attempts": 0, "restarts": 0, "mesh_sha256": key.sha256, "file_type": file_type,
            "parameters": key.parameters, "policy": key.policy, "request": request, "created_at": datetime.now(UTC),
        },
    ).one()  # fmt: skip
    return _record(row)


def get_job(connection: Connection, job_id: str) -> JobRecord:
    """Return a job; NotFoundError if there is none of this id."""
    row = connection.execute(_GET, {"job_id": job_id}).one_or_none()
    if row is None:
        raise NotFoundError(f"no job {job_id}")
    return _record(row)


def list_jobs(connection: Connection, *, state: JobState | None, limit: int) -> list[JobRecord]:
    """Return the newest jobs, of one state if given."""
    query = select(jobs).order_by(jobs.c.seq.desc()).limit(limit)
    if state is not None:
        query = query.where(jobs.c.state == state)
    return [_record(row) for row in connection.execute(query)]


def find_active(connection: Connection, *, kind: JobKind, key: UploadKey) -> JobRecord | None:
    """Return the unfinished job that computes this already, if there is one."""
    sought = {"kind": kind, "sha256": key.sha256, "parameters": key.parameters, "policy": key.policy}
    row = connection.execute(_ACTIVE, sought).one_or_none()
    return None if row is None else _record(row)


def count_queued(connection: Connection, before: int | None = None) -> int:
    """Return how many jobs wait, all or those ahead of the job with this seq."""
    found = connection.scalar(_COUNT) if before is None else connection.scalar(_COUNT_BEFORE, {"before": before})
    return found or 0


def claim(connection: Connection) -> JobRecord | None:
    """Take the oldest queued job to run it; None where the queue is empty."""
    row = connection.execute(_CLAIM, {"now": datetime.now(UTC)}).one_or_none()
    return None if row is None else _record(row)


def give_back(connection: Connection, job_id: str, *, lost: Lost) -> None:
    """Put a running job back into the queue, at its old place; count what was lost."""
    values: dict[str, Any] = {"state": "queued", "stage": "queued", "started_at": None}
    if lost != "worker":
        values["attempts"] = jobs.c.attempts - 1
    if lost == "server":
        values["restarts"] = jobs.c.restarts + 1
    connection.execute(update(jobs).where(jobs.c.id == job_id, jobs.c.state == "running").values(**values))


def finish(
    connection: Connection,
    job_id: str,
    state: JobState,
    *,
    error: dict[str, Any] | None = None,
    result: dict[str, Any] | None = None,
    shape_id: str | None = None,
    warnings: Sequence[str] = (),
    reached: dict[str, Any] | None = None,
) -> JobRecord | None:
    """End an unfinished job and forget its mesh if nothing else needs it; None if it had ended before."""
    values: dict[str, Any] = {
        "state": state,
        "finished_at": datetime.now(UTC),
        "error": error,
        "result": without_gone(connection, result),  # shapes may have been removed since it was made
        "warnings": list(warnings),
    }
    values |= {"stage": "done", "progress": 1.0, "shape_id": shape_id} if state == "succeeded" else reached or {}
    row = connection.execute(_FINISH, {"job_id": job_id, **values}).one_or_none()
    if row is None:
        return None
    if shape_id is None:  # a shape needs it
        drop_unused_mesh(connection, row.mesh_sha256)
    return _record(row)


def running_jobs(connection: Connection) -> list[JobRecord]:
    """Return the jobs that a server was running when it was last here."""
    return [_record(row) for row in connection.execute(select(jobs).where(jobs.c.state == "running"))]


def _record(row: Row[Any]) -> JobRecord:
    return JobRecord(**row._asdict())
