"""Jobs: status, long polls, events, files, cancellation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

from fastapi import APIRouter, Header, Query, Request, Response
from fastapi.responses import JSONResponse
from pydantic import AwareDatetime, BeforeValidator

from unbend.api.context import job_path
from unbend.api.routes.downloads import MEDIA_TYPES, file_content, file_response
from unbend.api.routes.events import (
    ALL_EVENTS_SCHEMA,
    EVENT_SCHEMA,
    HEADERS,
    EventStream,
    all_events,
    event_id,
    events,
    parse_id,
)
from unbend.api.routes.senders import may_see, must_see, owner_of
from unbend.api.schema.fields import CURSOR, EXACT_ID, JobId, as_instant
from unbend.api.schema.headers import DISPOSITION
from unbend.api.schema.links import job_links, next_page, shape_links
from unbend.api.schema.models import Forgotten, Job, JobList, JobSummary
from unbend.api.schema.problems import problem_responses
from unbend.api.server.service import Service, ServiceDependency
from unbend.library.jobs import JobFilter
from unbend.library.records import JobRecord
from unbend.results.jobs import JobKind, JobState

router = APIRouter(prefix="/jobs", tags=["jobs"])

MAX_WAIT_SECONDS = 60.0


@router.get(
    "",
    responses={
        200: {"links": job_links("$response.body#/items/0/id") | next_page("list_jobs")},
        **problem_responses(422),
    },
)
async def list_jobs(
    service: ServiceDependency,
    request: Request,
    state: Annotated[JobState | None, Query(description="Only jobs in this state.")] = None,
    kind: Annotated[JobKind | None, Query(description="Only jobs of this kind.")] = None,
    shape_id: Annotated[str | None, Query(pattern=EXACT_ID, description="Only jobs of this shape.")] = None,
    cursor: Annotated[str | None, Query(pattern=CURSOR, description="`next_cursor` of the page before.")] = None,
    limit: Annotated[int, Query(ge=1, le=500)] = 100,
) -> JobList:
    """List jobs without their results, the newest first."""
    page, ahead = await service.runner.page(
        JobFilter(state, kind, shape_id, owner_of(request)), cursor=cursor, limit=limit
    )
    items = [JobSummary.of(record, ahead.get(record.id)) for record in page.items]
    return JobList(items=items, next_cursor=page.next_cursor)


@router.delete("", responses=problem_responses(422))
async def forget_jobs(
    service: ServiceDependency,
    request: Request,
    before: Annotated[
        AwareDatetime, BeforeValidator(as_instant), Query(description="An instant with its offset (RFC 3339).")
    ],
) -> Forgotten:
    """Delete the jobs that ended before an instant. Their shapes stay."""
    return Forgotten(forgotten=await service.runner.delete_ended(before, owner_of(request)))


@router.get(
    "/events",
    response_class=EventStream,
    responses={
        200: {
            "description": "Server-Sent Events: `data` is a job without its result, as one line of JSON.",
            "content": {EventStream.media_type: {"schema": ALL_EVENTS_SCHEMA}},
        },
        **problem_responses(503),
    },
)
async def follow_jobs(service: ServiceDependency, request: Request) -> Response:
    """Follow all jobs in one stream.

    The stream begins with the queued and running jobs. An event follows for each job that is sent, progresses or
    changes its state, at most four a second for each job. The stream closes when the server stops: reconnect then, and
    read the jobs that ended meanwhile with `GET /jobs`.
    """
    service.waits.check()
    owner = owner_of(request)
    followed = service.metrics.counted_stream(all_events(service.runner, lambda job: may_see(owner, job)))
    return EventStream(service.waits.stream(followed), headers=HEADERS)


@router.get(
    "/{job_id}", responses={200: {"links": shape_links("$response.body#/shape_id")}, **problem_responses(404, 422)}
)
async def get_job(
    service: ServiceDependency,
    request: Request,
    job_id: JobId,
    wait: Annotated[
        float, Query(ge=0, le=MAX_WAIT_SECONDS, description="Respond when the job has ended, or after these seconds.")
    ] = 0.0,
) -> Job:
    """Return a job; with `wait` this is a long poll."""
    job = must_see(request, await service.runner.status(job_id))
    if not wait:
        return await _with_position(service, job)
    with service.waits.one():
        record = await service.runner.wait(job_id, wait)
    return await _with_position(service, record)


@router.get(
    "/{job_id}/events",
    response_class=EventStream,
    responses={
        200: {
            "description": "Server-Sent Events: `id` numbers the progress, `data` is the job as one line of JSON.",
            "content": {EventStream.media_type: {"schema": EVENT_SCHEMA}},
        },
        204: {
            "description": "The job has ended, and the client has its last event by `Last-Event-ID`: do not reconnect."
        },
        **problem_responses(404, 422, 503),
    },
)
async def follow_job(
    service: ServiceDependency,
    request: Request,
    job_id: JobId,
    last_event_id: Annotated[
        str | None, Header(description="The `id` of the last event that the client received, which is not sent again.")
    ] = None,
) -> Response:
    """Follow a job: an event at each change of state, stage or progress, at most four a second.

    After the event of the ended job the stream closes. It also closes when the server stops: then reconnect.
    """
    last = parse_id(last_event_id)
    record = must_see(request, await service.runner.status(job_id))
    if record.finished and event_id(record) == last:
        return Response(status_code=204, headers=HEADERS)
    service.waits.check()
    followed = service.metrics.counted_stream(events(service.runner, job_id, last))
    return EventStream(service.waits.stream(followed), headers=HEADERS)


@router.get(
    "/{job_id}/file",
    response_class=Response,
    responses={
        200: {"description": "The file.", "headers": DISPOSITION, "content": file_content(*MEDIA_TYPES)},
        **problem_responses(404, 422),
    },
)
async def get_job_file(service: ServiceDependency, request: Request, job_id: JobId) -> Response:
    """Download the file of a job of the kind `file`; it is kept for a day."""
    job = must_see(request, await service.runner.status(job_id))
    made = await service.runner.file(job)
    return file_response(made.data, made.file_type, made.name)


@router.delete(
    "/{job_id}",
    responses={200: {"links": job_links("$response.body#/id", "cancel_job")}, **problem_responses(404, 422)},
)
async def cancel_job(service: ServiceDependency, request: Request, job_id: JobId) -> Job:
    """Cancel a job. A running job is stopped; an ended job does not change."""
    must_see(request, await service.runner.status(job_id))
    return await _with_position(service, await service.runner.cancel(job_id))


async def accepted(service: Service, record: JobRecord, headers: Mapping[str, str] | None = None) -> Response:
    """Return the 202 response for a job that a request created."""
    job = await _with_position(service, record)
    return JSONResponse(job.model_dump(mode="json"), 202, {"Location": job_path(job.id), **(headers or {})})


async def _with_position(service: Service, record: JobRecord) -> Job:
    return Job.of(record, await service.runner.position(record))
