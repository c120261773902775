"""The ASGI application of a worker: probes and metrics, while it runs the jobs of a cluster."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from fastapi import FastAPI

from unbend import __version__
from unbend.api.routes import health
from unbend.api.schema import problems
from unbend.api.server.metrics import Metrics
from unbend.api.server.running import open_traces, running_service
from unbend.api.server.settings import Settings


def create_worker_app(settings: Settings) -> FastAPI:
    """Return an application that runs jobs from its startup to its shutdown.

    It answers /livez, /readyz, /capacity and /metrics, and needs no key, because these name no shape.
    """
    metrics, traces = Metrics(), open_traces(settings.traces)

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        async with running_service(settings, metrics, traces) as service:
            app.state.service = service
            yield

    app = FastAPI(
        title="unbend worker", version=__version__, lifespan=lifespan, docs_url=None, redoc_url=None, openapi_url=None
    )
    app.include_router(health.router)
    problems.install(app)
    return app
