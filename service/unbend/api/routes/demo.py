"""The route that adds the demo shapes to the library."""

from __future__ import annotations

import asyncio

from fastapi import APIRouter, Request

from unbend.api.routes.senders import key_of
from unbend.api.schema.models import DemoJobs
from unbend.api.schema.problems import problem_responses
from unbend.api.server.service import ServiceDependency
from unbend.library.jobs import Sender
from unbend.library.records import JobRecord
from unbend.library.requests import ShapeRequest, Upload
from unbend.mesh.policy import MeshPolicy
from unbend.mesh.shapes import demo_shapes
from unbend.signature.parameters import Parameters

router = APIRouter(prefix="/demo", tags=["library"])


@router.post("", status_code=202, responses=problem_responses(429))
async def load_demo(service: ServiceDependency, request: Request) -> DemoJobs:
    """Send generated bent shapes to the library: sheets, tubes, animals, hands, each in several poses."""
    key = key_of(request)
    sender, most = Sender(key.id if key else None), key.most_jobs if key else None
    sent = 0
    for upload, description in await asyncio.to_thread(_uploads):
        found = await service.runner.submit_shape(upload, description, sender, most)
        sent += isinstance(found, JobRecord)
    return DemoJobs(jobs=sent)


def _uploads() -> list[tuple[Upload, ShapeRequest]]:
    return [
        (
            Upload(shape.as_ply(), "ply", Parameters(), MeshPolicy()),
            ShapeRequest.of(shape.name, {"label": shape.label}, "keep"),
        )
        for shape in demo_shapes()
    ]
