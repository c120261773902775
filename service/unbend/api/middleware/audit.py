"""The audit log: one line of JSON for each request that changes the library or tries to."""

from __future__ import annotations

import json
import logging
from typing import Any, Final

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from unbend.api.context import API_PREFIX, CALLER, is_guarded, scope_of

logger = logging.getLogger("unbend.audit")

_JOBS: Final = f"{API_PREFIX}/jobs/"


class Audit:
    """ASGI middleware that logs the caller, method, path, status and ids of each write, but no headers and no body."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, and log a write after its response."""
        if not _writes(scope):
            await self._app(scope, receive, send)
            return
        start: Message = {"status": 500, "headers": []}  # stays if an unexpected error comes before the response

        async def watching(message: Message) -> None:
            nonlocal start
            if message["type"] == "http.response.start":
                start = message
            await send(message)

        try:
            await self._app(scope, receive, watching)
        finally:
            line = _line(scope, start)
            logger.info("%s", json.dumps(line), extra={"details": line})


def _writes(scope: Scope) -> bool:
    return scope["type"] == "http" and is_guarded(scope["path"]) and scope_of(scope["method"], scope["path"]) == "write"


def _line(scope: Scope, start: Message) -> dict[str, Any]:
    client, _ = scope.get("client") or (None, None)
    line = {
        "key": scope.get(CALLER, "none"),
        "client": client,
        "method": scope["method"],
        "path": scope["path"],
        "status": start["status"],
    }
    place = Headers(raw=start["headers"]).get("location", "")
    made = {"job_id": place.removeprefix(_JOBS)} if place.startswith(_JOBS) else {}
    return {**line, **scope.get("path_params", {}), **made}
