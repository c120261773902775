"""The ASGI application: routes, middleware, and the start and stop of its parts."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Final

from fastapi import Depends, FastAPI
from fastapi_offline import FastAPIOffline
from starlette.middleware.cors import CORSMiddleware

from unbend import __version__
from unbend.api.context import API_PREFIX
from unbend.api.middleware.access import Access
from unbend.api.middleware.audit import Audit
from unbend.api.middleware.body_limits import BodyLimit, Framing
from unbend.api.middleware.compression import Compression
from unbend.api.middleware.methods import Methods
from unbend.api.middleware.prefix import ASSETS, Prefix
from unbend.api.middleware.requests import RequestLogging
from unbend.api.middleware.response_budget import ResponseBudget
from unbend.api.middleware.security_headers import SecurityHeaders
from unbend.api.routes import backups, demo, health, jobs, matches, overview, page, pictures, queries, shapes
from unbend.api.routes.unknown_fields import no_other_parameters
from unbend.api.schema import problems
from unbend.api.schema.openapi import install_schema
from unbend.api.server.metrics import Metrics
from unbend.api.server.running import open_traces, running_service
from unbend.api.server.settings import Settings
from unbend.library.storage.lease import Lease

if TYPE_CHECKING:
    from unbend.api.server.traces import Traces

_DESCRIPTION = """Recognise shapes however they bend.

Upload meshes with `POST /v1/shapes`; each gets a *bending-invariant signature* (Elad & Kimmel, PAMI 2003).
`POST /v1/queries` ranks the classes and stored shapes that are most similar to a mesh, whatever its pose.
"""

# Headers that pages of other websites may send and read, besides those that every website may.
_REQUEST_HEADERS: Final = (
    "Authorization", "Content-Type", "Idempotency-Key", "If-Match", "If-None-Match", "If-Range", "Last-Event-ID",
    "Prefer", "Range",
)  # fmt: skip
_RESPONSE_HEADERS: Final = (
    "Accept-Ranges", "Content-Disposition", "Content-Range", "ETag", "Location", "Preference-Applied", "Retry-After",
    "WWW-Authenticate", "X-Request-ID",
)  # fmt: skip


def create_app(settings: Settings | None = None, lease: Lease | None = None) -> FastAPI:
    """Return the service as an ASGI application.

    At startup it opens the library and starts the workers. /docs and /redoc load nothing from other servers.

    Parameters
    ----------
    settings : Settings, optional
        From the environment by default.
    lease : Lease, optional
        The lease of the library; by default acquired at startup, which raises StoreInUseError if another server has it.
    """
    chosen = settings or Settings()
    metrics, traces = Metrics(), open_traces(chosen.traces)

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        async with running_service(chosen, metrics, traces, lease) as service:
            app.state.service = service
            yield

    app = FastAPIOffline(
        title="unbend", version=__version__, description=_DESCRIPTION, lifespan=lifespan, static_url=ASSETS,
        redirect_slashes=False, generate_unique_id_function=lambda route: route.name,
    )  # fmt: skip
    for routes in (shapes, pictures, jobs, queries, matches, overview, demo, backups, health):
        app.include_router(routes.router, prefix=API_PREFIX, dependencies=[Depends(no_other_parameters)])
    app.include_router(page.router, include_in_schema=False)
    _add_middleware(app, chosen, metrics, traces)
    problems.install(app)
    install_schema(app)
    return app


def _add_middleware(app: FastAPI, settings: Settings, metrics: Metrics, traces: Traces | None) -> None:
    """Add middleware, the innermost first. `Access` checks a request before any byte of the body is read."""
    app.add_middleware(Methods)
    app.add_middleware(Compression)
    app.add_middleware(ResponseBudget, together=settings.max_answering_mb * 2**20)
    app.add_middleware(BodyLimit, limits=settings.body_limits)
    app.add_middleware(Access, settings=settings)
    app.add_middleware(Framing)
    if settings.origins:
        app.add_middleware(
            CORSMiddleware,
            allow_origins=settings.origins,
            allow_methods=["GET", "HEAD", "POST", "PATCH", "DELETE"],
            allow_headers=_REQUEST_HEADERS,
            expose_headers=_RESPONSE_HEADERS,
        )
    app.add_middleware(Audit)
    app.add_middleware(SecurityHeaders)
    if traces:
        from unbend.api.server.traces import TracedRequests  # noqa: PLC0415

        app.add_middleware(TracedRequests, traces=traces)
    app.add_middleware(RequestLogging, metrics=metrics)
    if settings.root_path:
        app.add_middleware(Prefix, prefix=settings.root_path)
