"""Jobs: status, waiting, cancelling."""

from __future__ import annotations

import asyncio
from typing import Annotated

from fastapi import APIRouter, Header, Query, Response

from unbend.api.events import EVENT_SCHEMA, HEADERS, EventStream, event_id, events, parse_id
from unbend.api.fields import JobId
from unbend.api.links import job_links, shape_links
from unbend.api.models import Job, JobList
from unbend.api.problems import problem_responses
from unbend.api.service import Service, ServiceDependency
from unbend.library.records import JobRecord, JobState

router = APIRouter(prefix="/jobs", tags=["jobs"])

MAX_WAIT_SECONDS = 60.0


@router.get("", responses={200: {"links": job_links("$response.body#/items/0/id")}, **problem_responses(422)})
async def list_jobs(
    service: ServiceDependency,
    state: Annotated[JobState | None, Query(description="Only jobs in this state.")] = None,
    limit: Annotated[int, Query(ge=1, le=500)] = 100,
) -> JobList:
    """List jobs, the newest first."""
    records = await service.runner.newest(state=state, limit=limit)
    return JobList(items=list(await asyncio.gather(*(_with_position(service, record) for record in records))))


@router.get(
    "/{job_id}", responses={200: {"links": shape_links("$response.body#/shape_id")}, **problem_responses(404, 422)}
)
async def get_job(
    service: ServiceDependency,
    job_id: JobId,
    wait: Annotated[
        float, Query(ge=0, le=MAX_WAIT_SECONDS, description="Answer when the job has ended, or after these seconds.")
    ] = 0.0,
) -> Job:
    """Return a job; with `wait` this is a long poll."""
    if not wait:
        return await _with_position(service, await service.runner.status(job_id))
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
    job_id: JobId,
    last_event_id: Annotated[
        str | None, Header(description="The `id` of the event that came last: it is not sent again.")
    ] = None,
) -> Response:
    """Follow a job: an event at each change of state, stage or progress, four a second at most.

    The last is the ended job, and the stream closes. It also closes when the server stops: come back then.
    """
    last = parse_id(last_event_id)
    record = await service.runner.status(job_id)
    if record.finished and event_id(record) == last:
        return Response(status_code=204, headers=HEADERS)
    service.waits.check()
    followed = service.metrics.counted_stream(events(service.runner, job_id, last))
    return EventStream(service.waits.stream(followed), headers=HEADERS)


@router.delete(
    "/{job_id}",
    responses={200: {"links": job_links("$response.body#/id", "cancel_job")}, **problem_responses(404, 422)},
)
async def cancel_job(service: ServiceDependency, job_id: JobId) -> Job:
    """Cancel a job. One that runs is stopped; one that has ended stays as it is."""
    return await _with_position(service, await service.runner.cancel(job_id))


async def _with_position(service: Service, record: JobRecord) -> Job:
    return Job.of(record, await service.runner.position(record))
