"""The durable queue: rows of `jobs` and the moves between their states."""

from __future__ import annotations

import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Final, Literal

from sqlalchemy import Connection, bindparam, delete, exists, func, insert, select, update
from sqlalchemy.engine import Row

from unbend.errors import NotFoundError
from unbend.library.answers import pack_answer, unpack_answer
from unbend.library.erasing import mark_erased
from unbend.library.key import UploadKey
from unbend.library.records import JobFile, JobKind, JobPage, JobRecord, JobState
from unbend.library.schema import Instant, job_files, jobs
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
_SENT = (
    select(jobs)
    .where(jobs.c.idempotency == bindparam("idempotency"), jobs.c.created_at >= bindparam("since", type_=Instant()))
    .order_by(jobs.c.seq.desc())
)
_COUNT = select(func.count()).select_from(jobs).where(jobs.c.state == "queued")
_OWNED = jobs.c.owner.is_not_distinct_from(bindparam("owner"))
_COUNT_OF = select(func.count()).select_from(jobs).where(_UNFINISHED, _OWNED)
_COUNT_OF_BEFORE = _COUNT.where(_OWNED, jobs.c.seq < bindparam("seq"))
_BY_OWNER = (
    select(jobs.c.owner, func.count().label("number")).where(jobs.c.state == bindparam("state")).group_by(jobs.c.owner)
)
_other = jobs.alias("other")
_COMPUTED_ALREADY = exists().where(
    _other.c.state == "running",
    _other.c.kind == "shape",
    _other.c.mesh_sha256 == jobs.c.mesh_sha256,
    _other.c.parameters == jobs.c.parameters,
    _other.c.policy == jobs.c.policy,
)
_OLDEST = (
    select(jobs.c.seq)
    .where(jobs.c.state == "queued", _OWNED, (jobs.c.kind != "shape") | ~_COMPUTED_ALREADY)
    .order_by(jobs.c.seq)
    .limit(1)
)
_NTH = (
    select(jobs.c.seq)
    .where(jobs.c.state == "queued", _OWNED)
    .order_by(jobs.c.seq)
    .limit(1)
    .offset(bindparam("skipped"))
)
_CLAIM = (
    update(jobs)
    .where(jobs.c.seq == bindparam("chosen"), jobs.c.state == "queued")
    .values(
        state="running", stage="starting", attempts=jobs.c.attempts + 1, started_at=bindparam("now", type_=Instant())
    )
    .returning(*jobs.c)
)
_FINISH = update(jobs).where(jobs.c.id == bindparam("job_id"), _UNFINISHED).returning(*jobs.c)


@dataclass(frozen=True)
class Sender:
    """The sender of a job, and how a repeated request is recognised."""

    owner: str | None = None
    """A key's id; None where none is needed."""
    idempotency: str | None = None
    """A hash of who sends it and of the name that they gave the request."""
    fingerprint: str | None = None
    """A hash of what was sent."""
    callback: str | None = None
    """An address that is to be told of the job's end."""


NOBODY: Final = Sender()


def enqueue(
    connection: Connection,
    *,
    kind: JobKind,
    key: UploadKey,
    file_type: str,
    request: dict[str, Any],
    sender: Sender = NOBODY,
    shape_id: str | None = None,
) -> JobRecord:
    """Append a job whose mesh is stored already; of one that makes a file, of which shape."""
    row = connection.execute(
        _ENQUEUE,
        {
            "id": uuid.uuid4().hex, "kind": kind, "state": "queued", "stage": "queued", "progress": 0.0,
            "attempts": 0, "restarts": 0, "mesh_sha256": key.sha256, "file_type": file_type,
            "parameters": key.parameters, "policy": key.policy, "request": request, "created_at": datetime.now(UTC),
            "shape_id": shape_id, **vars(sender),
        },
    ).one()  # fmt: skip
    return _record(row)


def find_sent(connection: Connection, idempotency: str, since: datetime) -> JobRecord | None:
    """Return the job that was sent under this name before, if that was not too long ago."""
    row = connection.execute(_SENT, {"idempotency": idempotency, "since": since}).first()
    return None if row is None else _record(row, unpack_answer(connection, row.result))


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
    owner: str | None = None
    """Those of one key; of all where it is None."""


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
    """Return how many jobs are to be begun before each that waits, by id."""
    found = {job.id: position(connection, job) for job in page if job.state == "queued"}
    return {job_id: ahead for job_id, ahead in found.items() if ahead is not None}


def forget_ended(
    connection: Connection, *, before: datetime | None = None, keep: int | None = None, owner: str | None = None
) -> int:
    """Forget some of the jobs that have ended; return how many. Called again until none is left, others go between.

    Parameters
    ----------
    connection : Connection
    before : datetime, optional
        Those that ended before.
    keep : int, optional
        All but the newest so many.
    owner : str, optional
        Only those of one key.
    """
    ended = jobs.c.state.in_(_ENDED)
    if before is not None:
        which = ended & (jobs.c.finished_at < before)
    else:
        newest = (
            select(jobs.c.seq).where(ended).order_by(jobs.c.seq.desc()).offset(keep or 0).limit(1).scalar_subquery()
        )
        which = ended & (jobs.c.seq <= newest)
    if owner is not None:
        which &= jobs.c.owner == owner
    seqs = connection.scalars(select(jobs.c.seq).where(which).limit(_FORGOTTEN)).all()
    connection.execute(delete(jobs).where(jobs.c.seq.in_(seqs)))
    if seqs:
        mark_erased(connection, "soon")
    return len(seqs)


def count_queued(connection: Connection) -> int:
    """Return how many jobs wait."""
    return connection.scalar(_COUNT) or 0


def count_unfinished(connection: Connection, owner: str) -> int:
    """Return how many jobs of a key wait or run."""
    return connection.scalar(_COUNT_OF, {"owner": owner}) or 0


def claim(connection: Connection) -> JobRecord | None:
    """Take the job whose turn it is; None where the queue is empty, or what waits is being computed for another.

    Keys take turns: next is the oldest job of the one that has the fewest in hand. An upload waits while another of
    the same file is computed in the same way: there is nothing left to compute then.
    """
    seq = _next(connection)
    if seq is None:
        return None
    row = connection.execute(_CLAIM, {"chosen": seq, "now": datetime.now(UTC)}).one_or_none()
    return None if row is None else _record(row)


def position(connection: Connection, job: JobRecord) -> int | None:
    """Return how many jobs are to be begun before one that waits, as keys take turns; None if it does not wait."""
    if job.state != "queued":
        return None
    running, waiting = (_by_owner(connection, state) for state in ("running", "queued"))
    mine = connection.scalar(_COUNT_OF_BEFORE, {"owner": job.owner, "seq": job.seq}) or 0
    turn = mine + running.get(job.owner, 0)
    ahead = mine
    for owner, count in waiting.items():
        if owner != job.owner:
            in_hand = running.get(owner, 0)
            before = min(max(turn - in_hand, 0), count)
            ahead += before
            if before < count and before + in_hand == turn:  # at the same turn, the older goes first
                ahead += (connection.scalar(_NTH, {"owner": owner, "skipped": before}) or 0) < job.seq
    return ahead


def _next(connection: Connection) -> int | None:
    running, waiting = (_by_owner(connection, state) for state in ("running", "queued"))
    for count in sorted({running.get(owner, 0) for owner in waiting}):
        level = [owner for owner in waiting if running.get(owner, 0) == count]
        found: list[int | None] = [connection.scalar(_OLDEST, {"owner": owner}) for owner in level]
        if seqs := [seq for seq in found if seq is not None]:
            return min(seqs)
    return None


def _by_owner(connection: Connection, state: JobState) -> dict[str | None, int]:
    return {row.owner: row.number for row in connection.execute(_BY_OWNER, {"state": state})}


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
    ignored: Sequence[str] = (),
    file: JobFile | None = None,
    reached: dict[str, Any] | None = None,
) -> JobRecord | None:
    """End an unfinished job and forget its mesh if nothing else needs it; None if it had ended before."""
    values: dict[str, Any] = {
        "state": state,
        "finished_at": datetime.now(UTC),
        "error": error,
        "result": pack_answer(connection, result),
        "warnings": list(warnings),
        "ignored": list(ignored),
        "request": {},  # what was said of a shape is the shape's from now on, and goes with it
    }
    values |= {"stage": "done", "progress": 1.0, "shape_id": shape_id} if state == "succeeded" else reached or {}
    row = connection.execute(_FINISH, {"job_id": job_id, **values}).one_or_none()
    if row is None:
        return None
    if row.callback is not None:
        note_callback(connection, job_id, attempts=0, due=values["finished_at"])
    if file is not None:
        connection.execute(insert(job_files).values(job_seq=row.seq, **vars(file)))
    if shape_id is None:  # a shape needs it
        drop_unused_mesh(connection, row.mesh_sha256)
    return _record(row, unpack_answer(connection, row.result))


def due_callbacks(connection: Connection, now: datetime, limit: int) -> list[JobRecord]:
    """Return ended jobs whose addresses are to be told by now, the longest due first."""
    due = select(*_SUMMARY).where(jobs.c.callback_due <= now).order_by(jobs.c.callback_due).limit(limit)
    return [JobRecord(**row._asdict(), result=None) for row in connection.execute(due)]


def note_callback(connection: Connection, job_id: str, attempts: int, due: datetime | None) -> None:
    """Note that a job's address was told, or is to be told again when `due`."""
    changed = update(jobs).where(jobs.c.id == job_id).values(callback_attempts=attempts, callback_due=due)
    connection.execute(changed)


def get_file(connection: Connection, job: JobRecord) -> JobFile:
    """Return what a job made; NotFoundError if it makes no file, has not ended, or ended more than a day ago."""
    wanted = select(job_files.c.file_type, job_files.c.name, job_files.c.data).where(job_files.c.job_seq == job.seq)
    row = connection.execute(wanted).one_or_none()
    if row is None:
        raise NotFoundError(f"there is no file of job {job.id}, or not any more: files are kept for a day")
    return JobFile(**row._asdict())


def forget_files(connection: Connection, before: datetime) -> None:
    """Remove what jobs made that ended before an instant."""
    ended = select(jobs.c.seq).where(jobs.c.finished_at < before)
    if connection.execute(delete(job_files).where(job_files.c.job_seq.in_(ended))).rowcount:
        mark_erased(connection, "soon")


def running_jobs(connection: Connection) -> list[JobRecord]:
    """Return the jobs that a server was running when it was last here."""
    return [_record(row) for row in connection.execute(select(jobs).where(jobs.c.state == "running"))]


def _record(row: Row[Any], result: dict[str, Any] | None = None) -> JobRecord:
    return JobRecord(**row._asdict() | {"result": result})
