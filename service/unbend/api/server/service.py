"""The parts of a server that routes use, and the dependency that provides them."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field
from typing import Annotated, Final, cast

from fastapi import Depends, Request

from unbend.api.server.byte_cache import ByteCache
from unbend.api.server.metrics import Metrics
from unbend.api.server.settings import Settings
from unbend.api.server.wait_limit import WaitLimit
from unbend.jobs.runner import JobRunner
from unbend.library import Library
from unbend.library.request_rates import SharedRateLimit

_PICTURE_BYTES: Final = 2**26


@dataclass(frozen=True)
class Service:
    """The parts of a running server."""

    settings: Settings
    library: Library
    runner: JobRunner
    metrics: Metrics
    waits: WaitLimit
    shared_rates: SharedRateLimit | None = None
    """The buckets of callers that all servers of a cluster share; None in a library with one server."""
    backing_up: asyncio.Lock = field(default_factory=asyncio.Lock)
    """Locked while a request makes a backup."""
    pictures: ByteCache = field(default_factory=lambda: ByteCache(_PICTURE_BYTES))
    """Pictures and views of shapes."""


def service_of(request: Request) -> Service:
    """Return the service of a request; cheaper than `ServiceDependency`."""
    return cast("Service", request.app.state.service)


async def _service(request: Request) -> Service:  # async, because FastAPI runs sync dependencies in a thread
    return service_of(request)


ServiceDependency = Annotated[Service, Depends(_service)]
