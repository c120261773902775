"""A limit on the bytes of all responses that clients have not read yet."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from unbend.api.schema.problems import respond
from unbend.errors import BusyError
from unbend.heap import give_back

RETRY_SECONDS: Final = 5

_CHUNK: Final = 2**16
"""Chunk size. The server buffers a chunk until the client reads it, and gets no other chunk until then."""

_LARGE: Final = 2**23
"""Bytes of large responses after which it is worthwhile to return memory to the system."""

_QUIET_SECONDS: Final = 2.0


class ResponseBudget:
    """ASGI middleware that responds 503 if too many bytes of responses are unread.

    A response larger than a chunk counts until the client has read it; smaller ones are always sent. After large ones,
    the process returns memory to the system.
    """

    def __init__(self, app: ASGIApp, together: int) -> None:
        self._app = app
        self._limit = together
        self._unread = 0
        self._sent = 0
        self._timer: asyncio.TimerHandle | None = None

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, and send its response in chunks."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        start: Message | None = None
        refused = False

        async def budgeting(message: Message) -> None:
            nonlocal start, refused
            if message["type"] == "http.response.start":
                start = message
                return
            body = message.get("body", b"")
            if refused:
                return
            if start is not None:
                if len(body) > _CHUNK and self._unread + len(body) > self._limit:
                    refused = True
                    busy = BusyError("too many bytes of earlier responses are still unread", RETRY_SECONDS)
                    await respond(busy)(scope, receive, send)
                    return
                begun, start = start, None
                await send(begun)
            with self._counted(len(body)):
                for offset in range(0, len(body) - _CHUNK, _CHUNK):
                    await send({**message, "body": body[offset : offset + _CHUNK], "more_body": True})
                rest = (len(body) - 1) // _CHUNK * _CHUNK if body else 0
                await send({**message, "body": body[rest:]})

        await self._app(scope, receive, budgeting)

    @contextmanager
    def _counted(self, size: int) -> Iterator[None]:
        if size <= _CHUNK:
            yield
            return
        self._unread += size
        self._sent += size
        try:
            yield
        finally:
            self._unread -= size
            if self._sent > _LARGE:
                self._give_back_soon()

    def _give_back_soon(self) -> None:
        if self._timer:
            self._timer.cancel()
        loop = asyncio.get_running_loop()
        self._timer = loop.call_later(_QUIET_SECONDS, loop.run_in_executor, None, give_back)
        if not self._unread:
            self._sent = 0
