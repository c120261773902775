"""A job's way as Server-Sent Events (WHATWG HTML, section 9.2)."""

from __future__ import annotations

import json
import time
from collections.abc import AsyncIterator
from typing import Final

from fastapi.responses import StreamingResponse

from unbend.api.models import Job
from unbend.jobs import JobRunner
from unbend.jobs.observer import STAGES
from unbend.library.records import JobRecord

HEARTBEAT_SECONDS: Final = 15.0
"""Without an event for so long a comment is sent: proxies close what is silent, often after a minute."""

RETRY_MILLISECONDS: Final = 2000

HEADERS: Final = {"X-Accel-Buffering": "no"}
"""No proxy may hold events back: this is nginx' word for that. That none may keep them all answers say."""

_ROUND: Final = 1_000_000
_STEP: Final = 100_000
_SHARES: Final = 10_000  # the worker reports progress to four places
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
"""How OpenAPI documents an event."""


class EventStream(StreamingResponse):
    """A response of events."""

    media_type = "text/event-stream"


def event_id(job: JobRecord) -> int:
    """Return a number for where a job stands; equal only where state, stage and progress are.

    Made of what is stored and reported, so it means the same to the next server: millions count how often the job was
    begun, hundred thousands its step (the stages, waiting, ended), the rest is its progress. It grows, except that a
    server that stops in order takes its beginning back.
    """
    step = _ENDED if job.finished else _QUEUED if job.state == "queued" else STAGES.index(job.stage)
    return (job.attempts + job.restarts) * _ROUND + step * _STEP + round(job.progress * _SHARES)


def parse_id(text: str | None) -> int | None:
    """Return what a `Last-Event-ID` says; None, which is nobody's, where it is none of ours."""
    return int(text) if text and text.isascii() and text.isdecimal() and len(text) <= 18 else None


async def events(
    runner: JobRunner, job_id: str, last: int | None, *, heartbeat: float = HEARTBEAT_SECONDS
) -> AsyncIterator[str]:
    """Yield the events of a job, but not the one that the listener had last, until it ends or the server does."""
    yield f"retry: {RETRY_MILLISECONDS}\n\n"
    spoken = time.monotonic()
    async for job in runner.follow(job_id):
        current = event_id(job)
        now = time.monotonic()
        if current != last:
            document = Job.of(job, await runner.position(job)).model_dump(mode="json")
            # All ASCII: a line separator in a name would end the line for those who split as Python does.
            yield f"id: {current}\ndata: {json.dumps(document)}\n\n"
            last, spoken = current, now
        elif now - spoken >= heartbeat:
            yield ": nothing new\n\n"
            spoken = now
