"""The limit on a request's bytes, counted as they arrive: before anything is parsed or kept whole."""

from __future__ import annotations

from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from unbend.api.problems import Problem, answer
from unbend.errors import UploadTooLargeError


class BodyTooLarge(HTTPException):
    """The 413 of a body that turned out too large while it was read."""

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem.status, problem.detail)
        self.problem = problem


class BodyLimit:
    """ASGI middleware that answers 413 to a body of more than `limit` bytes, announced or not."""

    def __init__(self, app: ASGIApp, limit: int) -> None:
        self._app = app
        self._limit = limit

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, counting."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        announced = dict(scope["headers"]).get(b"content-length", b"0")
        if not announced.isdigit() or int(announced) > self._limit:
            await answer(self._problem())(scope, receive, send)
            return
        received = 0

        async def counting() -> Message:
            nonlocal received
            message = await receive()
            received += len(message.get("body", b""))
            if received > self._limit:
                # An HTTPException, for FastAPI turns any other error while it parses a body into a 400.
                raise BodyTooLarge(self._problem())
            return message

        await self._app(scope, counting, send)

    def _problem(self) -> Problem:
        return Problem(
            title="Content Too Large",
            status=413,
            detail=f"the request has more than {self._limit // 2**20} megabytes",
            code=UploadTooLargeError.code,
            advice=UploadTooLargeError.advice,
        )
