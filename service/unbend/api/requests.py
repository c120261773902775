"""What is kept of every request: an id that is given back, a line of the log, its time among the figures."""

from __future__ import annotations

import logging
import re
import time
import uuid
from contextvars import ContextVar
from typing import Final

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from unbend.api.metrics import Metrics

logger = logging.getLogger("unbend.requests")

HEADER: Final = "X-Request-ID"

PREFIX: Final = "/v1"

CURRENT_REQUEST: Final[ContextVar[str | None]] = ContextVar("unbend request", default=None)
"""The request that a line of the log belongs to. Each request is a task of its own, so it need not be reset."""

_SANE: Final = re.compile(r"[A-Za-z0-9._:+/=@-]{1,128}")
_METHODS: Final = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"})
PROBES: Final = frozenset({f"{PREFIX}/livez", f"{PREFIX}/readyz", f"{PREFIX}/metrics"})


class Requests:
    """ASGI middleware around everything else."""

    def __init__(self, app: ASGIApp, metrics: Metrics) -> None:
        self._app = app
        self._metrics = metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, watching."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        request_id = _request_id(Headers(scope=scope).get(HEADER))
        CURRENT_REQUEST.set(request_id)
        begun = time.perf_counter()
        status: int | None = None

        async def watching(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message)[HEADER] = request_id
                status = message["status"]
                self._metrics.answered(method_of(scope), route_of(scope), status, time.perf_counter() - begun)
            await send(message)

        try:
            await self._app(scope, receive, watching)
        except Exception:
            if status is None:  # the answer is made outside of all middleware, where the header is added too
                status = 500
                self._metrics.answered(method_of(scope), route_of(scope), status, time.perf_counter() - begun)
            raise
        finally:
            _log(scope, status, time.perf_counter() - begun)


def _request_id(given: str | None) -> str:
    return given if given and _SANE.fullmatch(given) else uuid.uuid4().hex


def method_of(scope: Scope) -> str:
    """Return a request's method, "other" if it is none of those there are."""
    method: str = scope["method"]
    return method if method in _METHODS else "other"


def route_of(scope: Scope) -> str:
    """Return the template of a request's path, "unmatched" where there is none: the path itself could be anything."""
    template: str | None = getattr(scope.get("route"), "path", None)
    if template is None:
        return "unmatched"
    # In later versions of FastAPI a router's own routes do not know the prefix it was included with.
    bare = scope["path"].startswith(f"{PREFIX}/") and not template.startswith(f"{PREFIX}/")
    return PREFIX + template if bare else template


def _log(scope: Scope, status: int | None, seconds: float) -> None:
    method, route, milliseconds = method_of(scope), route_of(scope), round(1000.0 * seconds, 1)
    level = logging.DEBUG if route in PROBES and status == 200 else logging.INFO
    details = {"method": method, "route": route, "status": status, "milliseconds": milliseconds}
    logger.log(level, "%s %s %s %.1f ms", method, route, status, milliseconds, extra={"details": details})
