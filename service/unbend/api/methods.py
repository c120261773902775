"""What every resource does beside its own methods: HEAD, OPTIONS, and an Allow header that has all of them."""

from __future__ import annotations

from typing import Final, cast

from fastapi import FastAPI
from starlette.datastructures import MutableHeaders
from starlette.responses import Response
from starlette.routing import Match, Mount
from starlette.types import ASGIApp, Message, Receive, Scope, Send

_METHODS: Final = ("GET", "POST", "PUT", "PATCH", "DELETE")
HEAD: Final = "unbend.head"
"""Whether, in the scope of a GET that stands for a HEAD, the body is left out: one that is costly need not be made."""

_ROUTED: Final = ("route", "endpoint", "path_params")
"""What routing leaves in a scope, for the log and the figures."""


class Methods:
    """ASGI middleware around the routes.

    HEAD is answered as GET is (RFC 9110, section 9.3.2); the server leaves the body out. OPTIONS is answered by the
    methods there are, and so is a method that there is not: a route knows only itself, and not others of the same path.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or answer which methods there are."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        if scope["method"] == "OPTIONS" and (allowed := _allowed(scope)):
            await Response(status_code=204, headers={"Allow": allowed})(scope, receive, send)
        elif scope["method"] == "HEAD":
            await self._head(scope, receive, send)
        else:
            await self._app(scope, receive, _allowing({**scope}, send))  # as it is before routes change it

    async def _head(self, scope: Scope, receive: Receive, send: Send) -> None:
        asked = {**scope, "method": "GET", HEAD: True}

        async def noting(message: Message) -> None:
            scope.update({name: asked[name] for name in _ROUTED if name in asked})
            await send(message)

        await self._app(asked, receive, _allowing(scope, noting))


def _allowing(scope: Scope, send: Send) -> Send:
    async def naming(message: Message) -> None:
        if message["type"] == "http.response.start" and message["status"] == 405:
            MutableHeaders(scope=message)["Allow"] = _allowed(scope)
        await send(message)

    return naming


def _allowed(scope: Scope) -> str:
    """Return the methods of a request's path, with commas between them; empty where there is nothing."""
    routes = cast("FastAPI", scope["app"]).router.routes
    found = [
        method
        for method in _METHODS
        if any(
            route.matches({**scope, "method": method})[0] is Match.FULL
            for route in routes
            if method == "GET" or not isinstance(route, Mount)  # which is of files, and asks only for the path
        )
    ]
    if not found:
        return ""
    return ", ".join([*found, *(["HEAD"] if "GET" in found else []), "OPTIONS"])
