"""What every route works with, and how it gets it."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field
from typing import Annotated, cast

from fastapi import Depends, Request

from unbend.api.metrics import Metrics
from unbend.api.settings import Settings
from unbend.api.waits import Waits
from unbend.jobs import JobRunner
from unbend.library import Library


@dataclass(frozen=True)
class Service:
    """The parts of a running server."""

    settings: Settings
    library: Library
    runner: JobRunner
    metrics: Metrics
    waits: Waits
    backing_up: asyncio.Lock = field(default_factory=asyncio.Lock)
    """Held while a backup is made for somebody who waits for it."""


def service_of(request: Request) -> Service:
    """Return the service that a request came to, where the way through `ServiceDependency` would cost too much."""
    return cast("Service", request.app.state.service)


async def _service(request: Request) -> Service:  # async, or FastAPI would go to a thread for it
    return service_of(request)


ServiceDependency = Annotated[Service, Depends(_service)]
