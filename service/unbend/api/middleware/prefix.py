"""The path prefix of a service behind a proxy, such as /shapes, whether or not the proxy removes the prefix."""

from __future__ import annotations

from typing import Final

from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

ASSETS: Final = "/docs-assets"
"""Path of the static files of the API's pages."""


class Prefix:
    """The outermost middleware: removes the prefix from paths, except those of `ASSETS`, and adds it to `Location`."""

    def __init__(self, app: ASGIApp, prefix: str) -> None:
        self._app = app
        self._prefix = prefix

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on with the prefix in `root_path`; only paths of `ASSETS` have it in `path`, too."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        path: str = scope["path"]
        if path == self._prefix or path.startswith(f"{self._prefix}/"):
            path = path.removeprefix(self._prefix) or "/"
        # Starlette finds the files of a mount only if the path begins with `root_path`.
        if path.startswith(f"{ASSETS}/"):
            path = self._prefix + path

        async def adding_prefix(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                if headers.get("location", "").startswith("/"):
                    headers["location"] = self._prefix + headers["location"]
            await send(message)

        # The pages of the API, and the OpenAPI document, read the prefix from the scope.
        await self._app({**scope, "path": path, "root_path": self._prefix}, receive, adding_prefix)
