"""Limits on the body of a request: its size, counted as it arrives, and its time."""

from __future__ import annotations

import asyncio
import sys
from typing import TYPE_CHECKING, Final, cast

from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from unbend.api.schema.problems import SEND_FILE, Problem, answer, headers_of, of_error, of_status, respond
from unbend.api.server.settings import BodyLimits
from unbend.errors import BusyError, StoreError, UnbendError, UploadTooLargeError, UploadTooSlowError

if TYPE_CHECKING:
    from unbend.api.server.service import Service

RETRY_SECONDS: Final = 5

_SMALL: Final = 2**16
"""Largest unread body that is read and discarded, so that the connection can be reused."""

_BODY_HEADERS: Final = frozenset({b"content-length", b"transfer-encoding", b"expect"})


class BodyRefused(HTTPException):
    """An error while a body is read. It is an HTTPException, because FastAPI turns any other error into a 400."""

    def __init__(self, error: UnbendError) -> None:
        self.problem = of_error(error)
        super().__init__(self.problem.status, self.problem.detail, headers_of(error))


class BodyLimit:
    """ASGI middleware that refuses bodies with 413, 408, 503 or 507, before they are complete or parsed."""

    def __init__(self, app: ASGIApp, limits: BodyLimits) -> None:
        self._app = app
        self._limits = limits
        self._buffered = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, and count the bytes of its body."""
        if scope["type"] != "http" or not has_body(scope):
            await self._app(scope, receive, send)
            return
        if refused := self._refused(scope):
            await respond(refused)(scope, receive, send)
            return
        loop = asyncio.get_running_loop()
        end = loop.time() + self._limits.seconds
        received, complete, responded = 0, False, False
        headers = Headers(scope=scope)
        most = self._most(headers)

        async def watching(message: Message) -> None:
            nonlocal responded
            responded = True
            await send(message)

        async def counting() -> Message:
            nonlocal received, complete
            if complete or responded:  # only the end of the connection, or unexpected data, can follow
                return await receive()
            try:
                async with asyncio.timeout(min(self._limits.stall_seconds, end - loop.time())):
                    message = await receive()
            except TimeoutError:
                if responded:
                    return {"type": "http.disconnect"}
                raise BodyRefused(UploadTooSlowError("the request's body took too long to arrive")) from None
            size = len(message.get("body", b""))
            received += size
            self._buffered += size
            complete = not message.get("more_body", False)
            if received > most:
                raise BodyRefused(self._too_large(headers))
            if self._buffered > self._limits.together:
                raise BodyRefused(BusyError("the bodies of all present requests are too large together", RETRY_SECONDS))
            return message

        try:
            await self._app(scope, counting, watching)
        finally:
            self._buffered -= received

    def _refused(self, scope: Scope) -> UnbendError | None:
        """Return the error of a body that is refused before it is read; None to read it."""
        headers = Headers(scope=scope)
        announced = _announced(headers)
        if announced > self._most(headers):
            return self._too_large(headers)
        if _is_upload(headers):
            try:
                cast("Service", scope["app"].state.service).library.check_writable(announced)
            except StoreError as error:
                return error
        return None

    def _most(self, headers: Headers) -> int:
        return self._limits.each if _is_upload(headers) else self._limits.json

    def _too_large(self, headers: Headers) -> UploadTooLargeError:
        if _is_upload(headers):
            return UploadTooLargeError(f"the request has more than {self._limits.each // 2**20} megabytes")
        kilobytes = self._limits.json // 2**10
        return UploadTooLargeError(f"a request without a file has more than {kilobytes} kilobytes").with_advice(
            f"{SEND_FILE} For other requests, send less, or raise UNBEND_MAX_JSON_KB."
        )


class Framing:
    """ASGI middleware that refuses ambiguous framing, and closes connections with an unread body.

    The end of a body with both a length and a transfer encoding is ambiguous: a proxy may choose a different end (RFC
    9112, section 6.3). If a response does not wait for the whole body, the server would otherwise read and discard the
    rest for as long as the client sends.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, and track how much of its body is read."""
        if scope["type"] != "http" or (scope["http_version"] == "1.1" and not has_body(scope)):
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        unread = "transfer-encoding" in headers or _announced(headers) > _SMALL or "expect" in headers

        async def reading() -> Message:
            nonlocal unread
            message = await receive()
            if not message.get("more_body", False):
                unread = False
            return message

        async def closing(message: Message) -> None:
            if message["type"] == "http.response.start" and unread:
                MutableHeaders(scope=message)["Connection"] = "close"
            await send(message)

        if refused := _ambiguity(scope["http_version"], headers):
            await answer(refused, {"Connection": "close"})(scope, receive, send)
            return
        await self._app(scope, reading, closing)


def has_body(scope: Scope) -> bool:
    """Return whether a request announces a body."""
    return any(name in _BODY_HEADERS for name, _ in scope["headers"])


def _is_upload(headers: Headers) -> bool:
    return headers.get("content-type", "").lower().startswith("multipart/form-data")


def _ambiguity(version: str, headers: Headers) -> Problem | None:
    if version not in {"1.0", "1.1"}:
        return of_status(505, "this server speaks HTTP/1.1")
    if "transfer-encoding" in headers and ("content-length" in headers or version == "1.0"):
        return of_status(
            400, "the end of the request's body is ambiguous: Transfer-Encoding with Content-Length, or in HTTP/1.0"
        )
    return None


def _announced(headers: Headers) -> int:
    length = headers.get("content-length", "0")
    return int(length) if length.isascii() and length.isdecimal() else sys.maxsize
