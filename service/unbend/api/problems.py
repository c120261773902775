"""Errors as RFC 9457 problem documents: one table from exception to status, one shape for all."""

from __future__ import annotations

import errno
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from http import HTTPStatus
from typing import Any, Final

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import BaseModel, Field
from starlette.exceptions import HTTPException

from unbend import errors
from unbend.api.headers import headers_for
from unbend.api.requests import CURRENT_REQUEST, HEADER

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
    errors.StoreError: 503,
    errors.UnbendError: 500,
}
"""Status of each error; the nearest base class that stands here decides."""


CHALLENGES: Final[dict[type[errors.UnbendError], str]] = {
    errors.KeyRequiredError: 'Bearer realm="unbend"',
    errors.KeyInvalidError: 'Bearer realm="unbend", error="invalid_token"',
    errors.ScopeError: 'Bearer realm="unbend", error="insufficient_scope", scope="write"',
}
"""What WWW-Authenticate says with these errors (RFC 6750, section 3)."""


class FieldProblem(BaseModel):
    """One field of a request that is not as it should be."""

    field: str = Field(description="Where the field is, as body.name or query.limit.", examples=["query.limit"])
    message: str


class Problem(BaseModel):
    """Any error, in the shape of RFC 9457."""

    type: str = Field("about:blank", examples=["about:blank"])
    title: str = Field(examples=["Not Found"])
    status: int = Field(examples=[404])
    detail: str = Field(examples=["no shape 0123456789abcdef"])
    code: str = Field(description="A stable name for programs.", examples=["not_found"])
    advice: str = Field("", description="What the caller can do.")
    errors: list[FieldProblem] = Field(default_factory=list, description="The fields that are not as they should be.")


class MediaTypeError(HTTPException):
    """The 415 of a request whose body is of another kind than the call takes."""

    def __init__(self, *taken: str) -> None:
        super().__init__(415, f"send {' or '.join(taken)}")


_ROUTING: Final = {404: "there is nothing at this address", 405: "what is at this address does not take {method}"}
"""In place of the phrase that is all that the router says."""

_FULL: Final = "the folder for temporary files has no room for the request's body"

_SHOWN: Final = 10
"""Fields that a problem names: a request may have thousands that are wrong."""

_SHOWN_TEXT: Final = 100

_TITLES: Final = {413: "Content Too Large", 422: "Unprocessable Content"}
"""Of statuses that Python's versions name differently."""


def problem_responses(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Return the OpenAPI entries of error answers with these statuses."""
    schema = {"schema": {"$ref": "#/components/schemas/Problem"}}
    return {status: {"description": _title(status), "content": {MEDIA_TYPE: schema}} for status in statuses}


@contextmanager
def pointing_at(field: str) -> Iterator[None]:
    """Have a ParameterError raised in this block name the field of the request that it is about."""
    try:
        yield
    except errors.ParameterError as error:
        error.field = field
        raise


def status_of(error: errors.UnbendError) -> int:
    """Return the HTTP status of an error of our tree."""
    return next(STATUS[kind] for kind in type(error).__mro__ if kind in STATUS)


def of_status(status: int, detail: str) -> Problem:
    """Return the problem of an error that has no name but its status."""
    title = _title(status)
    return Problem(title=title, status=status, detail=detail, code=title.lower().replace(" ", "_"))


def answer(problem: Problem, headers: dict[str, str] | None = None) -> JSONResponse:
    """Return a problem as a response."""
    content = problem.model_dump(exclude_defaults=False)
    return JSONResponse(content, problem.status, headers, media_type=MEDIA_TYPE)


def respond(error: errors.UnbendError) -> JSONResponse:
    """Return an error of our tree as a response."""
    return answer(of_error(error), headers_of(error))


def of_error(error: errors.UnbendError) -> Problem:
    """Return the problem that an error of our tree is."""
    status = status_of(error)
    if status >= 500:
        logger.error("a request failed: %s", error, exc_info=error)
    named = isinstance(error, errors.ParameterError) and error.field
    fields = [FieldProblem(field=named, message=str(error))] if named else []
    return Problem(
        title=_title(status), status=status, detail=str(error), code=error.code, advice=error.advice, errors=fields
    )


def headers_of(error: errors.UnbendError) -> dict[str, str] | None:
    """Return the headers that go with an error of our tree."""
    if isinstance(error, errors.BusyError | errors.QueueFullError | errors.QuotaError | errors.RateLimitError):
        return {"Retry-After": str(error.retry_after)}
    challenge = CHALLENGES.get(type(error))
    return {"WWW-Authenticate": challenge} if challenge else None


def install(app: FastAPI) -> None:
    """Have `app` answer every error as a problem document."""
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
        FieldProblem(field=".".join(str(part)[:_SHOWN_TEXT] for part in item["loc"]), message=str(item["msg"]))
        for item in found[:_SHOWN]
    ]
    detail = "; ".join(f"{item.field}: {item.message}" for item in fields)
    if len(found) > _SHOWN:
        detail += f"; and {len(found) - _SHOWN} more"
    return answer(Problem(title=_title(422), status=422, detail=detail, code="request_invalid", errors=fields))


async def _on_http(request: Request, error: Exception) -> JSONResponse:
    if not isinstance(error, HTTPException):
        raise error
    if _is_full(error.__cause__) or _is_full(error.__context__):  # FastAPI says that the body cannot be parsed
        return respond(errors.TemporaryFullError(_FULL))
    title, status = _title(error.status_code), error.status_code
    detail = _ROUTING.get(status, "{}") if error.detail == title else "{}"
    problem = getattr(error, "problem", None) or of_status(status, detail.format(error.detail, method=request.method))
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
        title=_title(500), status=500, detail="The service failed; its log says why.", code=errors.UnbendError.code
    )
    # sent from outside the middleware that adds them elsewhere
    return answer(problem, headers_for(request.url.path) | {HEADER: CURRENT_REQUEST.get() or ""})


def _title(status: int) -> str:
    return _TITLES.get(status) or HTTPStatus(status).phrase
