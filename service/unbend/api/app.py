"""Putting the service together."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from fastapi import APIRouter, FastAPI
from fastapi.responses import RedirectResponse
from fastapi_offline import FastAPIOffline
from starlette.middleware.cors import CORSMiddleware

from unbend import __version__
from unbend.api import problems
from unbend.api.access import Access
from unbend.api.audit import Audit
from unbend.api.headers import SecurityHeaders
from unbend.api.limits import BodyLimit
from unbend.api.methods import Methods
from unbend.api.metrics import Metrics
from unbend.api.openapi import install_schema
from unbend.api.requests import PREFIX, Requests
from unbend.api.routes import health, jobs, overview, queries, shapes
from unbend.api.service import Service
from unbend.api.settings import Settings
from unbend.jobs import JobRunner
from unbend.library import Library

_DESCRIPTION = """Recognise shapes however they bend.

Upload meshes with `POST /v1/shapes`; each gets a *bending-invariant signature* (Elad & Kimmel, PAMI 2003).
Ask `POST /v1/queries` what a mesh is and which stored shapes are like it, whatever their pose.
"""


def create_app(settings: Settings | None = None) -> FastAPI:
    """Return the service as an ASGI application.

    The library is opened, and workers started, when the application starts up. /docs and /redoc need nothing
    from elsewhere.
    """
    chosen = settings or Settings()
    metrics = Metrics()

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        library = Library(chosen.library)
        runner = JobRunner(library, workers=chosen.workers, limits=chosen.limits, observer=metrics)
        app.state.service = Service(chosen, library, runner, metrics)
        await runner.start()
        try:
            yield
        finally:
            await runner.stop()
            library.close()

    app = FastAPIOffline(
        title="unbend", version=__version__, description=_DESCRIPTION, lifespan=lifespan, static_url="/docs-assets",
        redirect_slashes=False, generate_unique_id_function=lambda route: route.name,
    )  # fmt: skip
    api = APIRouter(prefix=PREFIX)
    for room in (shapes, jobs, queries, overview, health):
        api.include_router(room.router)
    app.include_router(api)
    app.add_api_route("/", _to_docs, include_in_schema=False)
    _add_middleware(app, chosen, metrics)
    problems.install(app)
    install_schema(app)
    return app


def _add_middleware(app: FastAPI, settings: Settings, metrics: Metrics) -> None:
    """Put the layers on, the innermost first: who may not call has no byte of a body read."""
    app.add_middleware(Methods)
    app.add_middleware(BodyLimit, limit=settings.max_upload_mb * 2**20)
    app.add_middleware(Access, settings=settings)
    if settings.origins:
        app.add_middleware(
            CORSMiddleware,
            allow_origins=settings.origins,
            allow_methods=["GET", "HEAD", "POST", "PATCH", "DELETE"],
            allow_headers=["Authorization", "Content-Type", "Last-Event-ID", "Prefer"],
            expose_headers=["Content-Disposition", "Location", "Retry-After", "WWW-Authenticate", "X-Request-ID"],
        )
    app.add_middleware(Audit)
    app.add_middleware(SecurityHeaders)
    app.add_middleware(Requests, metrics=metrics)


async def _to_docs() -> RedirectResponse:
    return RedirectResponse("/docs")
