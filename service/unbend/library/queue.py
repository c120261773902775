"""The durable queue: rows of `jobs` and the moves between their states."""

from __future__ import annotations

import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Final, Literal

from sqlalchemy import Connection, bindparam, delete, func, insert, select, update
from sqlalchemy.engine import Row

from unbend.errors import NotFoundError
from unbend.library.answers import pack_answer, unpack_answer
from unbend.library.erasing import mark_erased
from unbend.library.key import UploadKey
from unbend.library.records import JobKind, JobPage, JobRecord, JobState
from unbend.library.schema import Instant, jobs
from unbend.library.shapes import as_seq, drop_unused_mesh

Lost = Literal["worker", "server", "nothing"]
"""Why a job is given back: its process died, the whole server died, or the server stops in order."""

_ENDED: Final = ("succeeded", "failed", "cancelled")
_FORGOTTEN: Final = 500
"""Jobs that are forgotten in one transaction: others that write wait for no more."""

_SUMMARY: Final = [column for column in jobs.c if column.name != "result"]

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
        raise NotFoundError(f"no job {job_id}: there is none, or it ended long ago and was forgotten")
    return _record(row, unpack_answer(connection, row.result))


@dataclass(frozen=True)
class JobFilter:
    """Which jobs a list has."""

    state: JobState | None = None
    kind: JobKind | None = None
    shape_id: str | None = None


def list_jobs(connection: Connection, which: JobFilter, *, cursor: str | None, limit: int) -> JobPage:
    """Return up to `limit` jobs that began before `cursor`, the newest first, without their results."""
    query = select(*_SUMMARY).order_by(jobs.c.seq.desc()).limit(limit + 1)
    for name, value in vars(which).items():
        if value is not None:
            query = query.where(jobs.c[name] == value)
    if cursor is not None:
        query = query.where(jobs.c.seq < as_seq(cursor))
    rows = [JobRecord(**row._asdict(), result=None) for row in connection.execute(query)]
    page = rows[:limit]
    return JobPage(page, str(page[-1].seq) if len(rows) > limit else None)


def positions(connection: Connection, page: Sequence[JobRecord]) -> dict[str, int]:
    """Return how many jobs wait before each that waits, by id."""
    waiting = [job.seq for job in page if job.state == "queued"]
    if not waiting:
        return {}
    ahead = (func.row_number().over(order_by=jobs.c.seq) - 1).label("ahead")
    numbered = (
        select(jobs.c.id, jobs.c.seq, ahead).where(jobs.c.state == "queued", jobs.c.seq <= max(waiting)).subquery()
    )
    rows = connection.execute(select(numbered.c.id, numbered.c.ahead).where(numbered.c.seq >= min(waiting)))
    return {row.id: row.ahead for row in rows}


def forget_ended(connection: Connection, *, before: datetime | None = None, keep: int | None = None) -> int:
    """Forget some of the jobs that have ended; return how many. Called again until none is left, others go between.

    Parameters
    ----------
    connection : Connection
    before : datetime, optional
        Those that ended before.
    keep : int, optional
        All but the newest so many.
    """
    ended = jobs.c.state.in_(_ENDED)
    if before is not None:
        which = ended & (jobs.c.finished_at < before)
    else:
        newest = (
            select(jobs.c.seq).where(ended).order_by(jobs.c.seq.desc()).offset(keep or 0).limit(1).scalar_subquery()
        )
        which = ended & (jobs.c.seq <= newest)
    seqs = connection.scalars(select(jobs.c.seq).where(which).limit(_FORGOTTEN)).all()
    connection.execute(delete(jobs).where(jobs.c.seq.in_(seqs)))
    if seqs:
        mark_erased(connection, "soon")
    return len(seqs)


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
        "result": pack_answer(connection, result),
        "warnings": list(warnings),
        "request": {},  # what was said of a shape is the shape's from now on, and goes with it
    }
    values |= {"stage": "done", "progress": 1.0, "shape_id": shape_id} if state == "succeeded" else reached or {}
    row = connection.execute(_FINISH, {"job_id": job_id, **values}).one_or_none()
    if row is None:
        return None
    if shape_id is None:  # a shape needs it
        drop_unused_mesh(connection, row.mesh_sha256)
    return _record(row, unpack_answer(connection, row.result))


def running_jobs(connection: Connection) -> list[JobRecord]:
    """Return the jobs that a server was running when it was last here."""
    return [_record(row) for row in connection.execute(select(jobs).where(jobs.c.state == "running"))]


def _record(row: Row[Any], result: dict[str, Any] | None = None) -> JobRecord:
    return JobRecord(**row._asdict() | {"result": result})
