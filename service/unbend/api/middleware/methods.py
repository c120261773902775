"""The methods HEAD and OPTIONS for every resource, and the Allow header."""

from __future__ import annotations

from typing import Final, cast

from fastapi import FastAPI
from starlette.datastructures import MutableHeaders
from starlette.responses import Response
from starlette.routing import Match, Mount
from starlette.types import ASGIApp, Message, Receive, Scope, Send

_METHODS: Final = ("GET", "POST", "PUT", "PATCH", "DELETE")
HEAD: Final = "unbend.head"
"""Key in the ASGI scope of a GET that serves a HEAD: routes may then omit an expensive body."""

_ROUTED: Final = ("route", "endpoint", "path_params")
"""Keys that routing adds to a scope, which logs and metrics read."""


class Methods:
    """ASGI middleware around the routes.

    HEAD is routed as GET (RFC 9110, section 9.3.2), and the server omits the body. The Allow header of OPTIONS
    and 405 responses has the methods of all routes of the path, because each route knows only its own methods.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or respond with the allowed methods."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        if scope["method"] == "OPTIONS" and (allowed := _allowed(scope)):
            await Response(status_code=204, headers={"Allow": allowed})(scope, receive, send)
        elif scope["method"] == "HEAD":
            await self._head(scope, receive, send)
        else:
            await self._app(scope, receive, _allowing({**scope}, send))  # a copy, because routes change the scope

    async def _head(self, scope: Scope, receive: Receive, send: Send) -> None:
        as_get = {**scope, "method": "GET", HEAD: True}

        async def noting(message: Message) -> None:
            scope.update({name: as_get[name] for name in _ROUTED if name in as_get})
            await send(message)

        await self._app(as_get, receive, _allowing(scope, noting))


def _allowing(scope: Scope, send: Send) -> Send:
    async def naming(message: Message) -> None:
        if message["type"] == "http.response.start" and message["status"] == 405:
            MutableHeaders(scope=message)["Allow"] = _allowed(scope)
        await send(message)

    return naming


def _allowed(scope: Scope) -> str:
    """Return the methods of a path, separated by commas; empty for an unknown path."""
    routes = cast("FastAPI", scope["app"]).router.routes
    found = [
        method
        for method in _METHODS
        if any(
            route.matches({**scope, "method": method})[0] is Match.FULL
            for route in routes
            if method == "GET" or not isinstance(route, Mount)  # mounted files match by path only
        )
    ]
    if not found:
        return ""
    return ", ".join([*found, *(["HEAD"] if "GET" in found else []), "OPTIONS"])
