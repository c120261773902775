"""Probes, capacity and metrics."""

from __future__ import annotations

from fastapi import APIRouter, Response
from prometheus_client import CONTENT_TYPE_LATEST

from unbend.api.schema.models import Capacity, Health
from unbend.api.schema.problems import ProblemError, problem_responses
from unbend.api.server.service import ServiceDependency
from unbend.errors import StoreError

router = APIRouter(tags=["health"])


@router.get("/livez", responses=problem_responses(503))
async def livez(service: ServiceDependency) -> Health:
    """Respond 200 while the server claims jobs from the queue; otherwise it should be restarted."""
    if not service.runner.alive:
        raise ProblemError(503, "the dispatcher has died", "Restart the server.")
    return Health()


@router.get("/readyz", responses=problem_responses(503))
async def readyz(service: ServiceDependency) -> Health:
    """Respond 200 once jobs can start: the workers have loaded their kernels, and the library can be written.

    A starting server accepts uploads earlier; their jobs wait.
    """
    if not service.runner.alive:
        raise ProblemError(503, "no job can start: the workers or the dispatcher failed", "Restart the server.")
    if not service.runner.ready:
        raise ProblemError(
            503,
            "the workers load or compile their kernels; uploads are accepted, and their jobs wait",
            "Ask again in a few seconds; compiling takes about a minute.",
        )
    try:
        service.library.check_writable()
    except StoreError as error:
        raise ProblemError(503, str(error), error.advice) from None
    return Health()


@router.get("/capacity")
async def capacity(service: ServiceDependency) -> Capacity:
    """Return the numbers of running and queued jobs, of all servers and workers that share the library."""
    runner = service.runner
    workers, running = runner.capacity
    return Capacity(workers=workers, running=running, queued=await runner.queued(), max_queued=runner.limits.queued)


@router.get(
    "/metrics",
    response_class=Response,
    responses={200: {"description": "The metrics.", "content": {"text/plain": {"schema": {"type": "string"}}}}},
)
async def metrics(service: ServiceDependency) -> Response:
    """Return metrics of load, jobs, requests and the process in the format of Prometheus."""
    text = await service.metrics.text(service.runner, service.library)
    return Response(text, headers={"Content-Type": CONTENT_TYPE_LATEST})
