"""Errors as problem documents (RFC 9457), and their HTTP statuses."""

from __future__ import annotations

import errno
import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from http import HTTPStatus
from typing import Any, Final

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import BaseModel, Field
from starlette.exceptions import HTTPException

from unbend import errors
from unbend.api.context import CURRENT_REQUEST, REQUEST_ID
from unbend.api.schema.fields import PATTERNS
from unbend.api.schema.headers import headers_for

logger = logging.getLogger("unbend.api")

MEDIA_TYPE: Final = "application/problem+json"

STATUS: Final[dict[type[errors.UnbendError], int]] = {
    errors.MeshFormatError: 415,
    errors.MeshError: 422,
    errors.ParameterError: 422,
    errors.UnsuitedError: 409,
    errors.NotFoundError: 404,
    errors.ChangedError: 412,
    errors.AccessError: 403,
    errors.KeyRequiredError: 401,
    errors.KeyInvalidError: 401,
    errors.RateLimitError: 429,
    errors.UploadTooLargeError: 413,
    errors.UploadTooSlowError: 408,
    errors.BusyError: 503,
    errors.QueueFullError: 429,
    errors.QuotaError: 429,
    errors.IdempotencyError: 409,
    errors.JobTimeoutError: 504,
    errors.JobMemoryError: 507,
    errors.JobCancelledError: 409,
    errors.JobError: 500,
    errors.StoreFullError: 507,
    errors.TemporaryFullError: 507,
    errors.ObjectDamagedError: 500,
    errors.StoreError: 503,
    errors.UnbendError: 500,
}
"""HTTP status of each error class; subclasses inherit it."""


_PASSING: Final = (
    errors.BusyError,
    errors.QueueFullError,
    errors.QuotaError,
    errors.RateLimitError,
    errors.StoreUnavailableError,
)
"""Errors that pass: their responses say when to try again."""

CHALLENGES: Final[dict[type[errors.UnbendError], str]] = {
    errors.KeyRequiredError: 'Bearer realm="unbend"',
    errors.KeyInvalidError: 'Bearer realm="unbend", error="invalid_token"',
    errors.ScopeError: 'Bearer realm="unbend", error="insufficient_scope", scope="write"',
}
"""The WWW-Authenticate header of these errors (RFC 6750, section 3)."""


class FieldProblem(BaseModel):
    """An invalid field of a request."""

    field: str = Field(
        description="The place of the field, such as body.name or query.limit.", examples=["query.limit"]
    )
    message: str


class Problem(BaseModel):
    """An error as a problem document (RFC 9457)."""

    type: str = Field("about:blank", examples=["about:blank"])
    title: str = Field(examples=["Not Found"])
    status: int = Field(examples=[404])
    detail: str = Field(examples=["no shape 0123456789abcdef"])
    code: str = Field(description="A stable name for programs.", examples=["not_found"])
    advice: str = Field("", description="What the caller can do.")
    errors: list[FieldProblem] = Field(default_factory=list, description="The invalid fields.")


class ProblemError(HTTPException):
    """A response with this status, and with advice."""

    def __init__(self, status: int, detail: str, advice: str, headers: dict[str, str] | None = None) -> None:
        self.problem = of_status(status, detail).model_copy(update={"advice": advice})
        super().__init__(status, detail, headers)


class MediaTypeError(ProblemError):
    """The 415 response to a body of a type that the endpoint does not accept; `taken` are sentences about its types."""

    def __init__(self, *taken: str) -> None:
        advice = [text for kind, text in _SENDING.items() if any(each.startswith(kind) for each in taken)]
        super().__init__(415, f"send {' or '.join(taken)}", " ".join(advice))


SEND_FILE: Final = (
    "Send the file as a part of a form (multipart/form-data) with a file name, as curl -F file=@PATH does."
)

_SENDING: Final = {
    "multipart/form-data": SEND_FILE,
    "application/json": "Send JSON with the header Content-Type: application/json.",
}
"""Advice to clients that send another type of body."""


_ROUTING: Final = {404: "there is no resource at this path", 405: "the resource at this path does not support {method}"}
"""Messages that replace those of the router."""

_ADVICE: Final = {404: "The page /docs lists all resources.", 405: "Use one of the methods in the header Allow."}
"""Advice for the errors of the router."""

NO_FIELD: Final = "there is no such field"

_CORRECT: Final = "Correct what the message names; the page /docs of the server describes all fields."
"""Advice for invalid fields that have no advice of their own."""

_FULL: Final = "the folder for temporary files has no space for the request's body"

_SHOWN: Final = 10
"""Maximum number of fields in a problem, because a request may have thousands of invalid fields."""

_SHOWN_TEXT: Final = 100

_TITLES: Final = {413: "Content Too Large", 416: "Range Not Satisfiable", 422: "Unprocessable Content"}
"""Titles of statuses whose names differ between versions of Python."""


def problem_responses(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Return the OpenAPI documentation of error responses with these statuses."""
    schema = {"schema": {"$ref": "#/components/schemas/Problem"}}
    return {status: {"description": _title(status), "content": {MEDIA_TYPE: schema}} for status in statuses}


@contextmanager
def pointing_at(field: str) -> Iterator[None]:
    """Set the field of the request on every ParameterError that this block raises."""
    try:
        yield
    except errors.ParameterError as error:
        error.field = field
        raise


def status_of(error: errors.UnbendError) -> int:
    """Return the HTTP status of an error."""
    return next(STATUS[kind] for kind in type(error).__mro__ if kind in STATUS)


def of_status(status: int, detail: str) -> Problem:
    """Return the problem of an HTTP status."""
    title = _title(status)
    return Problem(title=title, status=status, detail=detail, code=title.lower().replace(" ", "_"))


def answer(problem: Problem, headers: dict[str, str] | None = None) -> JSONResponse:
    """Return a problem as a response."""
    content = problem.model_dump(exclude_defaults=False)
    return JSONResponse(content, problem.status, headers, media_type=MEDIA_TYPE)


def respond(error: errors.UnbendError) -> JSONResponse:
    """Return the response for an error."""
    return answer(of_error(error), headers_of(error))


def of_error(error: errors.UnbendError) -> Problem:
    """Return the problem of an error."""
    status = status_of(error)
    if status >= 500:
        logger.error("a request failed: %s", error, exc_info=error)
    named = isinstance(error, errors.ParameterError) and error.field
    fields = [FieldProblem(field=named, message=str(error))] if named else []
    return Problem(
        title=_title(status), status=status, detail=str(error), code=error.code, advice=error.advice, errors=fields
    )


def headers_of(error: errors.UnbendError) -> dict[str, str] | None:
    """Return the headers of the response for an error."""
    if isinstance(error, _PASSING):
        return {"Retry-After": str(error.retry_after)}
    challenge = CHALLENGES.get(type(error))
    return {"WWW-Authenticate": challenge} if challenge else None


def install(app: FastAPI) -> None:
    """Make `app` respond to every error with a problem document."""
    app.add_exception_handler(errors.UnbendError, _on_known)
    app.add_exception_handler(RequestValidationError, _on_validation)
    app.add_exception_handler(HTTPException, _on_http)
    app.add_exception_handler(OSError, _on_system)
    app.add_exception_handler(Exception, _on_unexpected)


async def _on_known(_request: Request, error: Exception) -> JSONResponse:
    if not isinstance(error, errors.UnbendError):
        raise error
    return respond(error)


async def _on_validation(_request: Request, error: Exception) -> JSONResponse:
    if not isinstance(error, RequestValidationError):
        raise error
    found = error.errors()
    fields = [
        FieldProblem(field=".".join(str(part)[:_SHOWN_TEXT] for part in item["loc"]), message=_message(item))
        for item in found[:_SHOWN]
    ]
    advice = dict.fromkeys(item.get("advice", _CORRECT) for item in found)
    detail = "; ".join(f"{item.field}: {item.message}" for item in fields)
    if len(found) > _SHOWN:
        detail += f"; and {len(found) - _SHOWN} more"
    return answer(
        Problem(
            title=_title(422), status=422, detail=detail, code="request_invalid", advice=" ".join(advice), errors=fields
        )
    )


def _message(item: Mapping[str, Any]) -> str:
    """Return what is wrong with a field, without terms of the library that found it."""
    if item["type"] == "extra_forbidden":
        return NO_FIELD
    if item["type"] == "string_pattern_mismatch":
        return PATTERNS.get(item["ctx"]["pattern"], str(item["msg"]))
    return str(item["msg"]).removeprefix("Value error, ")


async def _on_http(request: Request, error: Exception) -> JSONResponse:
    if not isinstance(error, HTTPException):
        raise error
    if _is_full(error.__cause__) or _is_full(error.__context__):  # FastAPI hides this behind a 400
        return respond(errors.TemporaryFullError(_FULL))
    title, status = _title(error.status_code), error.status_code
    problem: Problem | None = getattr(error, "problem", None)
    if problem is None:
        is_routing = error.detail == title
        detail = _ROUTING.get(status, "{}") if is_routing else "{}"
        problem = of_status(status, detail.format(error.detail, method=request.method))
        problem.advice = _ADVICE.get(status, "") if is_routing else ""
    return answer(problem, dict(error.headers or {}))


async def _on_system(request: Request, error: Exception) -> JSONResponse:
    if _is_full(error):
        return respond(errors.TemporaryFullError(_FULL))
    return await _on_unexpected(request, error)


def _is_full(error: BaseException | None) -> bool:
    return isinstance(error, OSError) and error.errno in {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}


async def _on_unexpected(request: Request, error: Exception) -> JSONResponse:
    logger.error("a request failed with an unexpected error", exc_info=error)
    problem = Problem(
        title=_title(500), status=500, detail="The service failed; its log has the cause.", code=errors.UnbendError.code
    )
    # This response bypasses the middleware that adds these headers.
    return answer(problem, headers_for(request.url.path) | {REQUEST_ID: CURRENT_REQUEST.get() or ""})


def _title(status: int) -> str:
    return _TITLES.get(status) or HTTPStatus(status).phrase
