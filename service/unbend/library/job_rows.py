"""Rows of `jobs`: reads and writes within the caller's transaction."""

from __future__ import annotations

import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Final, Literal

from sqlalchemy import (
    ColumnElement,
    Connection,
    FromClause,
    Select,
    bindparam,
    delete,
    exists,
    func,
    insert,
    select,
    union_all,
    update,
)
from sqlalchemy.engine import Row

from unbend.errors import NotFoundError
from unbend.library.records import JobFile, JobPage, JobRecord
from unbend.library.requests import JobRequest, UploadKey, decode_parameters, decode_policy, decode_request, kind_of
from unbend.library.shape_rows import delete_unused_mesh, parse_cursor
from unbend.library.storage.log_eraser import mark_erased
from unbend.library.storage.postgres import without_wait
from unbend.library.storage.schema import Instant, job_files, jobs
from unbend.library.stored_rankings import pack_ranking, unpack_ranking
from unbend.progress import Progress
from unbend.results.jobs import ENDED_STATES, UNFINISHED_STATES, JobKind, JobState

Cause = Literal["process lost", "worker lost", "server lost", "objects unavailable", "stopped", "shape removed"]
"""The cause for which a running job returns to the queue.

Its process died; the worker of a cluster that ran it died, or was cut off; its server died; the object
store does not answer; its server stops; or somebody removed the known shape that would be its result.
"""

_BATCH: Final = 500
"""Largest number of jobs that one transaction deletes. It is small, so that other writers wait only briefly."""

_SUMMARY: Final = [column for column in jobs.c if column.name != "result"]

# Built once: building a statement costs more than running it.
_UNFINISHED = jobs.c.state.in_(UNFINISHED_STATES)
_ENQUEUE = insert(jobs).returning(*jobs.c)
_GET = select(jobs).where(jobs.c.id == bindparam("job_id"))
_LOCK = select(jobs.c.state, jobs.c.ticket).where(jobs.c.id == bindparam("job_id")).with_for_update()
_SENT = (
    select(jobs)
    .where(jobs.c.idempotency == bindparam("idempotency"), jobs.c.created_at >= bindparam("since", type_=Instant()))
    .order_by(jobs.c.seq.desc())
)
_QUEUED = jobs.c.state == "queued"
_COUNT_QUEUED = select(func.count()).select_from(jobs).where(_QUEUED)
_OWNED = jobs.c.owner.is_not_distinct_from(bindparam("owner"))
_COUNT_UNFINISHED = select(func.count()).select_from(jobs).where(_UNFINISHED, _OWNED)
_COUNT_OWNED_BEFORE = _COUNT_QUEUED.where(_OWNED, jobs.c.seq < bindparam("seq"))
_BY_OWNER = (
    select(jobs.c.owner, func.count().label("number")).where(jobs.c.state == bindparam("state")).group_by(jobs.c.owner)
)
_other = jobs.alias("other")
_EQUAL_UPLOAD_RUNS = exists().where(
    _other.c.state == "running",
    _other.c.kind == "shape",
    _other.c.mesh_sha256 == jobs.c.mesh_sha256,
    _other.c.parameters == jobs.c.parameters,
    _other.c.policy == jobs.c.policy,
)


def _turn(is_owner: Callable[[FromClause], ColumnElement[bool]], *owners: FromClause) -> Select[Any]:
    """Return a query for the oldest job of an owner that can start, and for the number of the owner's running jobs."""
    oldest = (
        select(jobs.c.seq)
        .where(_QUEUED, is_owner(jobs), (jobs.c.kind != "shape") | ~_EQUAL_UPLOAD_RUNS)
        .order_by(jobs.c.seq)
        .limit(1)
        .with_for_update(of=jobs, skip_locked=True)
    )
    running = select(func.count()).select_from(_other).where(_other.c.state == "running", is_owner(_other))
    numbers = [query.correlate(*owners).scalar_subquery() for query in (oldest, running)]
    return select(numbers[0].label("seq"), numbers[1].label("running")).select_from(*owners)


# Steps from owner to owner through the index. To group the whole queue would take longer, the longer the queue is.
_first = select(func.min(jobs.c.owner).label("owner")).where(_QUEUED).cte("waiting", recursive=True)
_following = select(func.min(jobs.c.owner)).where(_QUEUED, jobs.c.owner > _first.c.owner).scalar_subquery()
_waiting = _first.union_all(select(_following).where(_first.c.owner.is_not(None)))
_turns = union_all(
    _turn(lambda table: table.c.owner == _waiting.c.owner, _waiting), _turn(lambda table: table.c.owner.is_(None))
).subquery("turns")
_NEXT = select(_turns.c.seq).where(_turns.c.seq.is_not(None)).order_by(_turns.c.running, _turns.c.seq).limit(1)
_NTH = select(jobs.c.seq).where(_QUEUED, _OWNED).order_by(jobs.c.seq).limit(1).offset(bindparam("skipped"))
_CLAIM = (
    update(jobs)
    .where(jobs.c.seq == _NEXT.scalar_subquery(), _QUEUED)
    .values(
        state="running",
        stage="starting",
        attempts=jobs.c.attempts + 1,
        started_at=bindparam("now", type_=Instant()),
        ticket=bindparam("ticket", type_=jobs.c.ticket.type),
    )
    .returning(*jobs.c)
)
# A crash returns the job to the queue. Nobody was told then that the claim succeeded.
_CLAIM_WITHOUT_WAIT = without_wait(_CLAIM)
_CLAIMED = select(jobs).where(jobs.c.state == "running", jobs.c.ticket == bindparam("ticket"))
_FINISH = update(jobs).where(jobs.c.id == bindparam("job_id"), _UNFINISHED).returning(*jobs.c)
_FINISH_CLAIMED = _FINISH.where(jobs.c.ticket.is_not_distinct_from(bindparam("claimed", type_=jobs.c.ticket.type)))


@dataclass(frozen=True)
class Sender:
    """The sender of a job, and the hashes that recognise a repeated request."""

    owner: str | None = None
    """The id of an API key; None if the library needs no keys."""
    idempotency: str | None = None
    """A hash of the owner and the idempotency key."""
    fingerprint: str | None = None
    """A hash of the request's content."""
    callback: str | None = None
    """The URL of a webhook that reports the job's end."""


ANONYMOUS: Final = Sender()


def new_id() -> str:
    """Return the id of a new job."""
    return uuid.uuid4().hex


def enqueue(
    connection: Connection,
    *,
    job_id: str,
    key: UploadKey,
    file_type: str,
    request: JobRequest,
    sender: Sender = ANONYMOUS,
    shape_id: str | None = None,
) -> JobRecord:
    """Append a job whose mesh is stored already; `shape_id` is the shape from which a "file" job makes its file."""
    row = connection.execute(
        _ENQUEUE,
        {
            "id": job_id, "kind": kind_of(request), "state": "queued", "stage": "queued", "progress": 0.0,
            "attempts": 0, "restarts": 0, "mesh_sha256": key.sha256, "file_type": file_type,
            "parameters": key.parameters, "policy": key.policy, "request": request.as_dict(),
            "created_at": datetime.now(UTC), "shape_id": shape_id, **vars(sender),
        },
    ).one()  # fmt: skip
    return _record(row)


def find_sent(connection: Connection, idempotency: str, since: datetime) -> JobRecord | None:
    """Return the latest job since an instant that has this idempotency hash, if there is one."""
    row = connection.execute(_SENT, {"idempotency": idempotency, "since": since}).first()
    return None if row is None else _record(row, unpack_ranking(connection, row.result))


def get_job(connection: Connection, job_id: str) -> JobRecord:
    """Return a job; NotFoundError if there is none of this id."""
    job = find_job(connection, job_id)
    if job is None:
        raise NotFoundError(f"no job {job_id}; it may have ended long ago and been deleted")
    return job


def find_job(connection: Connection, job_id: str) -> JobRecord | None:
    """Return a job; None if there is none of this id."""
    row = connection.execute(_GET, {"job_id": job_id}).one_or_none()
    return None if row is None else _record(row, unpack_ranking(connection, row.result))


def is_current(connection: Connection, job: JobRecord) -> bool:
    """Return whether a job has not ended and still has the same ticket, and let nobody change that meanwhile.

    A job has another ticket if its worker was cut off for so long that the queue gave it to another worker.
    """
    row = connection.execute(_LOCK, {"job_id": job.id}).one_or_none()
    return row is not None and row.state in UNFINISHED_STATES and row.ticket == job.ticket


@dataclass(frozen=True)
class JobFilter:
    """Conditions on the jobs of a list."""

    state: JobState | None = None
    kind: JobKind | None = None
    shape_id: str | None = None
    owner: str | None = None
    """The id of an API key; None for the jobs of all keys."""


def list_jobs(connection: Connection, which: JobFilter, *, cursor: str | None, limit: int) -> JobPage:
    """Return up to `limit` jobs older than `cursor`, the newest first, without their results."""
    query = select(*_SUMMARY).order_by(jobs.c.seq.desc()).limit(limit + 1)
    for name, value in vars(which).items():
        if value is not None:
            query = query.where(jobs.c[name] == value)
    if cursor is not None:
        query = query.where(jobs.c.seq < parse_cursor(cursor))
    rows = [_record(row) for row in connection.execute(query)]
    page = rows[:limit]
    return JobPage(page, str(page[-1].seq) if len(rows) > limit else None)


def positions(connection: Connection, page: Sequence[JobRecord]) -> dict[str, int]:
    """Return the queue position of each queued job, by id."""
    found = {job.id: position(connection, job) for job in page if job.state == "queued"}
    return {job_id: ahead for job_id, ahead in found.items() if ahead is not None}


def delete_ended(
    connection: Connection, *, before: datetime | None = None, keep: int | None = None, owner: str | None = None
) -> int:
    """Delete one batch of ended jobs and return its size; call again until it is 0.

    Parameters
    ----------
    connection : Connection
    before : datetime, optional
        Delete jobs that ended before this instant.
    keep : int, optional
        Delete all but the newest `keep` jobs.
    owner : str, optional
        Delete only jobs of one API key.
    """
    ended = jobs.c.state.in_(ENDED_STATES)
    if before is not None:
        which = ended & (jobs.c.finished_at < before)
    else:
        newest = (
            select(jobs.c.seq).where(ended).order_by(jobs.c.seq.desc()).offset(keep or 0).limit(1).scalar_subquery()
        )
        which = ended & (jobs.c.seq <= newest)
    if owner is not None:
        which &= jobs.c.owner == owner
    seqs = connection.scalars(select(jobs.c.seq).where(which).limit(_BATCH)).all()
    connection.execute(delete(jobs).where(jobs.c.seq.in_(seqs)))
    if seqs:
        mark_erased(connection, "soon")
    return len(seqs)


def count_queued(connection: Connection) -> int:
    """Return the number of queued jobs."""
    return connection.scalar(_COUNT_QUEUED) or 0


def count_unfinished(connection: Connection, owner: str) -> int:
    """Return the number of queued and running jobs of an API key."""
    return connection.scalar(_COUNT_UNFINISHED, {"owner": owner}) or 0


def claim(connection: Connection, ticket: int | None = None) -> JobRecord | None:
    """Start the next job and return it; None if no queued job can start.

    API keys take turns: next is the oldest job of the key with the fewest running jobs. An upload waits while an equal
    upload runs, because it can then use the stored shape.
    """
    change = _CLAIM_WITHOUT_WAIT if connection.dialect.name == "postgresql" else _CLAIM
    row = connection.execute(change, {"ticket": ticket, "now": datetime.now(UTC)}).one_or_none()
    return None if row is None else _record(row)


def claimed(connection: Connection, ticket: int) -> JobRecord | None:
    """Return the job that runs under a ticket."""
    row = connection.execute(_CLAIMED, {"ticket": ticket}).one_or_none()
    return None if row is None else _record(row)


def position(connection: Connection, job: JobRecord) -> int | None:
    """Return the number of jobs that start before a queued job, as keys take turns; None if the job is not queued."""
    if job.state != "queued":
        return None
    running, waiting = (_by_owner(connection, state) for state in ("running", "queued"))
    mine = connection.scalar(_COUNT_OWNED_BEFORE, {"owner": job.owner, "seq": job.seq}) or 0
    turn = mine + running.get(job.owner, 0)
    ahead = mine
    for owner, count in waiting.items():
        if owner != job.owner:
            running_count = running.get(owner, 0)
            before = min(max(turn - running_count, 0), count)
            ahead += before
            if before < count and before + running_count == turn:  # in the same turn, the older job starts first
                ahead += (connection.scalar(_NTH, {"owner": owner, "skipped": before}) or 0) < job.seq
    return ahead


def _by_owner(connection: Connection, state: JobState) -> dict[str | None, int]:
    return {row.owner: row.number for row in connection.execute(_BY_OWNER, {"state": state})}


def requeue(connection: Connection, job: JobRecord, *, cause: Cause) -> None:
    """Return a running job to its old place in the queue, if it still runs under the same ticket.

    The attempt counts only if the job's process or worker died. A restart counts only if its worker or server died.
    """
    values: dict[str, Any] = {"state": "queued", "stage": "queued", "started_at": None, "ticket": None}
    if cause not in {"process lost", "worker lost"}:
        values["attempts"] = jobs.c.attempts - 1
    if cause in {"worker lost", "server lost"}:
        values["restarts"] = jobs.c.restarts + 1
    same = jobs.c.ticket.is_not_distinct_from(job.ticket)
    connection.execute(update(jobs).where(jobs.c.id == job.id, jobs.c.state == "running", same).values(**values))


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
    reached: Progress | None = None,
    claimed: JobRecord | None = None,
) -> JobRecord | None:
    """End an unfinished job, and delete its mesh if nothing else needs the mesh; None if the job had ended before.

    If `claimed` is given, this does nothing either if the job now has another ticket.
    """
    values: dict[str, Any] = {
        "state": state,
        "finished_at": datetime.now(UTC),
        "error": error,
        "result": pack_ranking(connection, result),
        "warnings": list(warnings),
        "ignored": list(ignored),
        "request": {},  # the shape now has the description, and removing the shape must remove every copy
    }
    if state == "succeeded":
        values |= {"stage": "done", "progress": 1.0, "shape_id": shape_id}
    elif reached:
        values |= {"stage": reached.stage, "progress": reached.share}
    if claimed is None:
        row = connection.execute(_FINISH, {"job_id": job_id, **values}).one_or_none()
    else:
        same = {"job_id": job_id, "claimed": claimed.ticket}
        row = connection.execute(_FINISH_CLAIMED, {**same, **values}).one_or_none()
    if row is None:
        return None
    if row.callback is not None:
        schedule_callback(connection, job_id, attempts=0, due=values["finished_at"])
    if file is not None:
        connection.execute(insert(job_files).values(job_seq=row.seq, **vars(file)))
    if shape_id is None:  # otherwise the shape needs its mesh
        delete_unused_mesh(connection, row.mesh_sha256)
    return _record(row, unpack_ranking(connection, row.result))


def has_due_callback(connection: Connection, now: datetime) -> bool:
    """Return whether the webhook of a job is due."""
    return bool(connection.scalar(select(exists().where(jobs.c.callback_due <= now))))


def take_callbacks(connection: Connection, now: datetime, until: datetime, limit: int) -> list[JobRecord]:
    """Return ended jobs whose webhooks are due, the longest due first; no other server takes them before `until`."""
    due = select(jobs.c.seq).where(jobs.c.callback_due <= now).order_by(jobs.c.callback_due).limit(limit)
    seqs = connection.scalars(due.with_for_update(skip_locked=True)).all()
    if not seqs:
        return []
    taken = update(jobs).where(jobs.c.seq.in_(seqs)).values(callback_due=until).returning(*_SUMMARY)
    rows = {row.seq: _record(row) for row in connection.execute(taken)}
    return [rows[seq] for seq in seqs]


def schedule_callback(connection: Connection, job_id: str, attempts: int, due: datetime | None) -> None:
    """Schedule the next attempt at a job's webhook; `due` is None after the last."""
    changed = update(jobs).where(jobs.c.id == job_id).values(callback_attempts=attempts, callback_due=due)
    connection.execute(changed)


def get_file(connection: Connection, job: JobRecord) -> JobFile:
    """Return the file of a job; NotFoundError if the job makes none, has not ended, or ended more than a day ago."""
    wanted = select(job_files.c.file_type, job_files.c.name, job_files.c.data).where(job_files.c.job_seq == job.seq)
    row = connection.execute(wanted).one_or_none()
    if row is None:
        raise NotFoundError(f"job {job.id} has no file; files are deleted after a day")
    return JobFile(**row._asdict())


def delete_files(connection: Connection, before: datetime) -> None:
    """Delete the files of jobs that ended before an instant."""
    ended = select(jobs.c.seq).where(jobs.c.finished_at < before)
    if connection.execute(delete(job_files).where(job_files.c.job_seq.in_(ended))).rowcount:
        mark_erased(connection, "soon")


def running_jobs(connection: Connection) -> list[JobRecord]:
    """Return the jobs that are running in the store."""
    return [_record(row) for row in connection.execute(select(jobs).where(jobs.c.state == "running"))]


def _record(row: Row[Any], result: dict[str, Any] | None = None) -> JobRecord:
    values = row._asdict() | {"result": result}
    values["parameters"] = decode_parameters(row.parameters)
    values["policy"] = decode_policy(row.policy)
    values["request"] = decode_request(row.kind, row.request)
    return JobRecord(**values)
