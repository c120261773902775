"""Compression of JSON responses with gzip. Files are not compressed: their numbers hardly shrink."""

from __future__ import annotations

import asyncio
import gzip
from functools import partial
from typing import Final

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

_SMALL: Final = 4096
"""Responses up to this size are not compressed, because they would not arrive sooner."""

_LARGE: Final = 2**16
"""Responses from this size on are compressed in a thread, so that the event loop stays free."""

_LEVEL: Final = 1
_JSON: Final = ("application/json", "application/problem+json")


class Compression:
    """ASGI middleware that compresses JSON responses that are sent in one message, as this service sends them.

    Responses with an ETag are not compressed, because an ETag identifies their exact bytes.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, and compress its response if the client accepts gzip."""
        if scope["type"] != "http" or not _accepts_gzip(Headers(scope=scope)):
            await self._app(scope, receive, send)
            return
        start: Message | None = None

        async def compressing(message: Message) -> None:
            nonlocal start
            if message["type"] == "http.response.start":
                start = message
                return
            if start is not None:
                begun, start = start, None
                if not message.get("more_body", False) and _is_compressible(begun, message.get("body", b"")):
                    message = await _compressed(begun, message)
                await send(begun)
            await send(message)

        await self._app(scope, receive, compressing)


async def _compressed(start: Message, message: Message) -> Message:
    body = message["body"]
    pack = partial(gzip.compress, body, _LEVEL, mtime=0)
    packed = await asyncio.to_thread(pack) if len(body) > _LARGE else pack()
    headers = MutableHeaders(scope=start)
    headers["Content-Encoding"] = "gzip"
    headers["Content-Length"] = str(len(packed))
    headers.add_vary_header("Accept-Encoding")
    return {**message, "body": packed}


def _is_compressible(start: Message, body: bytes) -> bool:
    headers = Headers(raw=start["headers"])
    kind = headers.get("content-type", "").partition(";")[0]
    return len(body) > _SMALL and kind in _JSON and not {"content-encoding", "etag"} & set(headers)


def _accepts_gzip(headers: Headers) -> bool:
    for part in headers.get("accept-encoding", "").lower().split(","):
        name, _, weight = part.partition(";")
        if name.strip() == "gzip":
            return weight.replace(" ", "") not in {"q=0", "q=0.0", "q=0.00", "q=0.000"}
    return False
