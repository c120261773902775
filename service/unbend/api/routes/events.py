"""The progress of a job as Server-Sent Events (WHATWG HTML, section 9.2)."""

from __future__ import annotations

import json
import time
from collections.abc import AsyncIterator, Callable
from typing import Final

from fastapi.responses import StreamingResponse

from unbend.api.schema.models import Job, JobSummary
from unbend.jobs.runner import JobRunner
from unbend.library.records import JobRecord
from unbend.progress import STAGES

HEARTBEAT_SECONDS: Final = 15.0
"""Time without an event after which a comment is sent: proxies close silent connections, often after a minute."""

RETRY_MILLISECONDS: Final = 2000

HEADERS: Final = {"X-Accel-Buffering": "no"}
"""Stops nginx from buffering events. `SecurityHeaders` adds no-store."""

_ROUND: Final = 1_000_000
_STEP: Final = 100_000
_SHARES: Final = 10_000  # steps of progress
_QUEUED, _ENDED = len(STAGES), len(STAGES) + 1


EVENT_SCHEMA: Final = {
    "type": "object",
    "properties": {
        "id": {"type": "string", "pattern": "^[0-9]+$"},
        "data": {
            "type": "string",
            "contentMediaType": "application/json",
            "contentSchema": {"$ref": "#/components/schemas/Job"},
        },
    },
    "required": ["id", "data"],
}
"""The schema of an event in OpenAPI."""

ALL_EVENTS_SCHEMA: Final = {
    "type": "object",
    "properties": {
        "data": {
            "type": "string",
            "contentMediaType": "application/json",
            "contentSchema": {"$ref": "#/components/schemas/JobSummary"},
        },
    },
    "required": ["data"],
}
"""The schema of an event of `all_events` in OpenAPI."""


class EventStream(StreamingResponse):
    """A response of events."""

    media_type = "text/event-stream"


def event_id(job: JobRecord) -> int:
    """Return a number that is equal only for equal state, stage and progress, to four places.

    The number depends only on stored and reported values, so that the next server can use it too. The millions count
    attempts and restarts, the hundred thousands are the step (a stage, queued or ended), and the rest is the progress.
    The number grows, unless a stopping server takes an attempt back.
    """
    step = _ENDED if job.finished else _QUEUED if job.state == "queued" else STAGES.index(job.stage)
    return (job.attempts + job.restarts) * _ROUND + step * _STEP + round(job.progress * _SHARES)


def parse_id(text: str | None) -> int | None:
    """Return the number in a `Last-Event-ID` header; None if it is not an id of `event_id`."""
    return int(text) if text and text.isascii() and text.isdecimal() and len(text) <= 18 else None


async def events(
    runner: JobRunner, job_id: str, last: int | None, *, heartbeat: float = HEARTBEAT_SECONDS
) -> AsyncIterator[str]:
    """Yield the events of a job, except the event `last`, until the job ends or the server stops."""
    yield f"retry: {RETRY_MILLISECONDS}\n\n"
    sent_at = time.monotonic()
    async for job in runner.follow(job_id):
        current = event_id(job)
        now = time.monotonic()
        if current != last:
            document = Job.of(job, await runner.position(job)).model_dump(mode="json")
            # ASCII only: some clients, such as Python's, would split the line at a line separator in a name.
            yield f"id: {current}\ndata: {json.dumps(document)}\n\n"
            last, sent_at = current, now
        elif now - sent_at >= heartbeat:
            yield ": nothing new\n\n"
            sent_at = now


async def all_events(
    runner: JobRunner, may_see: Callable[[JobRecord], bool], *, heartbeat: float = HEARTBEAT_SECONDS
) -> AsyncIterator[str]:
    """Yield the events of all jobs that a caller may see, until the server stops."""
    yield f"retry: {RETRY_MILLISECONDS}\n\n"
    sent_at = time.monotonic()
    async for job in runner.follow_all():
        now = time.monotonic()
        if job is not None and may_see(job):
            document = JobSummary.of(job, await runner.position(job)).model_dump(mode="json")
            yield f"data: {json.dumps(document)}\n\n"
            sent_at = now
        elif now - sent_at >= heartbeat:
            yield ": nothing new\n\n"
            sent_at = now
