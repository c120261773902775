"""Matches: which point of one stored shape is which point of another."""

from __future__ import annotations

import asyncio

from fastapi import APIRouter, Depends, Request, Response

from unbend.api.routes.downloads import sends
from unbend.api.routes.jobs import accepted
from unbend.api.routes.senders import IdempotencyKey, key_of, sender_of_file
from unbend.api.schema.headers import LOCATION
from unbend.api.schema.links import job_links
from unbend.api.schema.models import Job, Match
from unbend.api.schema.problems import problem_responses
from unbend.api.server.service import ServiceDependency
from unbend.library.requests import FileRequest

router = APIRouter(prefix="/matches", tags=["matches"])


@router.post(
    "",
    status_code=202,
    response_model=Job,
    responses={
        202: {"headers": LOCATION, "links": job_links("$response.body#/id")},
        **problem_responses(404, 409, 415, 422, 429),
    },
    dependencies=[Depends(sends("application/json"))],
)
async def match_shapes(
    service: ServiceDependency,
    request: Request,
    wanted: Match,
    idempotency_key: IdempotencyKey = None,  # noqa: ARG001  `sender_of_file` reads it
) -> Response:
    """Find for each vertex of one stored shape the point of another that is the same place.

    The response is the job that makes the file. Download it from `/jobs/{job_id}/file`: for each vertex of the first
    uploaded file, the vertices of the second at the corners of its triangle, their weights, and a confidence; or the
    first mesh in the colours of the second.
    """
    first, second = [await asyncio.to_thread(service.library.shapes.get, each) for each in (wanted.a, wanted.b)]
    arguments = {
        "other_id": second.id, "orientation": wanted.orientation, "part": wanted.part, "samples": wanted.samples,
        "file_type": wanted.format,
    }  # fmt: skip
    key = key_of(request)
    file = FileRequest("match", arguments, wanted.format, f"{first.name}-{second.name}")
    sender = sender_of_file(request, first.id, file)
    job = await service.runner.submit_file(first, file, sender, key.most_jobs if key else None)
    return await accepted(service, job)
