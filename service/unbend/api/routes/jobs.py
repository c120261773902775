"""Jobs: status, waiting, cancelling."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Header, Query, Request, Response
from pydantic import AwareDatetime, BeforeValidator

from unbend.api.events import EVENT_SCHEMA, HEADERS, EventStream, event_id, events, parse_id
from unbend.api.fields import JobId, as_instant
from unbend.api.headers import DISPOSITION
from unbend.api.links import job_links, next_page, shape_links
from unbend.api.models import Forgotten, Job, JobList, JobSummary
from unbend.api.negotiation import file_response
from unbend.api.problems import problem_responses
from unbend.api.senders import must_see, owner_of
from unbend.api.service import Service, ServiceDependency
from unbend.library.queue import JobFilter
from unbend.library.records import JobKind, JobRecord, JobState

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
    shape_id: Annotated[str | None, Query(pattern=r"^[0-9a-f]{32}$", description="Only jobs of this shape.")] = None,
    cursor: Annotated[
        str | None, Query(pattern=r"^[0-9]{1,18}$", description="`next_cursor` of the page before.")
    ] = None,
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
    """Forget the jobs that ended before an instant. Shapes that uploads became stay."""
    return Forgotten(forgotten=await service.runner.forget(before, owner_of(request)))


@router.get(
    "/{job_id}", responses={200: {"links": shape_links("$response.body#/shape_id")}, **problem_responses(404, 422)}
)
async def get_job(
    service: ServiceDependency,
    request: Request,
    job_id: JobId,
    wait: Annotated[
        float, Query(ge=0, le=MAX_WAIT_SECONDS, description="Answer when the job has ended, or after these seconds.")
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
            "description": "Server-Sent Events: `id` where the job stands, `data` the job as one line of JSON.",
            "content": {EventStream.media_type: {"schema": EVENT_SCHEMA}},
        },
        204: {"description": "The job has ended, and `Last-Event-ID` says that this is known: do not come back."},
        **problem_responses(404, 422, 503),
    },
)
async def follow_job(
    service: ServiceDependency,
    request: Request,
    job_id: JobId,
    last_event_id: Annotated[
        str | None, Header(description="The `id` of the event that came last: it is not sent again.")
    ] = None,
) -> Response:
    """Follow a job: an event at each change of state, stage or progress, four a second at most.

    The last is the ended job, and the stream closes. It also closes when the server stops: come back then.
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
        200: {"description": "The file.", "headers": DISPOSITION, "content": {"application/octet-stream": {}}},
        **problem_responses(404, 422),
    },
)
async def get_job_file(service: ServiceDependency, request: Request, job_id: JobId) -> Response:
    """Download what a job of the kind `file` made; it is kept for a day."""
    job = must_see(request, await service.runner.status(job_id))
    made = await service.runner.file(job)
    return file_response(made.data, made.file_type, made.name)


@router.delete(
    "/{job_id}",
    responses={200: {"links": job_links("$response.body#/id", "cancel_job")}, **problem_responses(404, 422)},
)
async def cancel_job(service: ServiceDependency, request: Request, job_id: JobId) -> Job:
    """Cancel a job. One that runs is stopped; one that has ended stays as it is."""
    must_see(request, await service.runner.status(job_id))
    return await _with_position(service, await service.runner.cancel(job_id))


async def _with_position(service: Service, record: JobRecord) -> Job:
    return Job.of(record, await service.runner.position(record))
