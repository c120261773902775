"""The path under which a proxy has the service, such as /shapes: proxies that take it away, and those that do not."""

from __future__ import annotations

from typing import Final

from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

ASSETS: Final = "/docs-assets"
"""Where the files of the API's pages are."""


class Prefix:
    """ASGI middleware around all others: within, paths have no prefix; `Location` leads back through the proxy."""

    def __init__(self, app: ASGIApp, prefix: str) -> None:
        self._app = app
        self._prefix = prefix

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on without the prefix."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        path: str = scope["path"]
        if path == self._prefix or path.startswith(f"{self._prefix}/"):
            path = path.removeprefix(self._prefix) or "/"
        if path.startswith(f"{ASSETS}/"):  # mounted files are looked for below the prefix
            path = self._prefix + path

        async def leading_back(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                if headers.get("location", "").startswith("/"):
                    headers["location"] = self._prefix + headers["location"]
            await send(message)

        # The pages of the API, and the document, take it from here.
        await self._app({**scope, "path": path, "root_path": self._prefix}, receive, leading_back)
