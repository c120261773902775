"""The id, log line and metrics of every request."""

from __future__ import annotations

import logging
import re
import time
import uuid
from typing import Final

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from unbend.api.context import CURRENT_REQUEST, PROBES, REQUEST_ID, method_of, route_of
from unbend.api.server.metrics import Metrics

logger = logging.getLogger("unbend.requests")

_VALID_ID: Final = re.compile(r"[A-Za-z0-9._:+/=@-]{1,128}")


class RequestLogging:
    """ASGI middleware that gives each request an id, logs it and records its metrics.

    Only `Prefix` is outside this middleware, so that even refused requests are logged.
    """

    def __init__(self, app: ASGIApp, metrics: Metrics) -> None:
        self._app = app
        self._metrics = metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, and record its response."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        request_id = _request_id(Headers(scope=scope).get(REQUEST_ID))
        CURRENT_REQUEST.set(request_id)
        begun = time.perf_counter()
        status: int | None = None

        async def watching(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message)[REQUEST_ID] = request_id
                status = message["status"]
                self._metrics.answered(method_of(scope), route_of(scope), status, time.perf_counter() - begun)
            await send(message)

        try:
            await self._app(scope, receive, watching)
        except Exception:
            if status is None:  # the outermost handler responds, and adds the header too
                status = 500
                self._metrics.answered(method_of(scope), route_of(scope), status, time.perf_counter() - begun)
            raise
        finally:
            _log(scope, status, time.perf_counter() - begun)


def _request_id(given: str | None) -> str:
    return given if given and _VALID_ID.fullmatch(given) else uuid.uuid4().hex


def _log(scope: Scope, status: int | None, seconds: float) -> None:
    method, route, milliseconds = method_of(scope), route_of(scope), round(1000.0 * seconds, 1)
    level = logging.DEBUG if route in PROBES and status == 200 else logging.INFO
    details = {"method": method, "route": route, "status": status, "milliseconds": milliseconds}
    logger.log(level, "%s %s %s %.1f ms", method, route, status, milliseconds, extra={"details": details})
