"""Requests and responses of the HTTP API, for both clients."""

from __future__ import annotations

import io
import json
import os
import re
import uuid
from collections.abc import Mapping
from typing import Any, Final
from urllib.parse import quote

import httpx
import numpy as np

from unbend.errors import JobError, NotFoundError, ParameterError, ServiceError, reported
from unbend.jsons import JsonObject
from unbend.results.jobs import JobFailure, JobStatus
from unbend.results.points import PointMap
from unbend.results.rankings import Ranking, shape_id_of
from unbend.results.shapes import AddedShape, ShapeRecord
from unbend.signature.signature import Signature

Json = dict[str, Any]

POLL_SECONDS: Final = 30.0
"""Longest time of a long poll."""

_PLACES: Final = re.compile(r"\b(body|query|path)\.(?=\w+: )")
"""Where the service found an invalid value, such as in `body.k: ...`; here it is an argument."""

_REFUSED: Final = "request_invalid"
"""The code of a request that the service's own validation refuses."""

IN_PLACE: Final = {"Prefer": f"wait={POLL_SECONDS:.0f}"}
"""Header that requests the ranking of a query in the response itself, if the ranking is ready in time."""


def shape_path(shape_id: str) -> str:
    """Return the path of a shape."""
    return f"/v1/shapes/{quote(shape_id, safe='')}"


def job_path(job_id: str) -> str:
    """Return the path of a job."""
    return f"/v1/jobs/{quote(job_id, safe='')}"


def given(**values: object) -> dict[str, str]:
    """Return the values that are not None as fields of a form or of a query string: text, and JSON for objects.

    Raises
    ------
    ParameterError
        If JSON or UTF-8 cannot represent a value.
    """
    return {name: _text_of(name, value) for name, value in values.items() if value is not None}


def _text_of(name: str, value: object) -> str:
    if isinstance(value, JsonObject):
        return value.to_json()
    return json_text(name, dict(value)) if isinstance(value, Mapping) else _encodable(name, str(value))


def json_text(name: str, value: object) -> str:
    """Return a value as JSON; ParameterError if JSON or UTF-8 cannot represent it. `name` is its name in the error."""
    try:
        text = json.dumps(value, allow_nan=False, ensure_ascii=False)
    except (TypeError, ValueError, RecursionError):
        raise ParameterError(f"{name} contains a value that JSON cannot represent") from None
    return _encodable(name, text)


def _encodable(name: str, text: str) -> str:
    try:
        text.encode()
    except UnicodeEncodeError:
        raise ParameterError(f"{name} contains a character that UTF-8 cannot represent") from None
    return text


def body(**values: object) -> Json:
    """Return the members of a body in JSON; ParameterError if JSON or UTF-8 cannot represent a value."""
    for name, value in values.items():
        json_text(name, value)
    return values


def stored(query: object) -> str | None:
    """Return the id of a query that is a stored shape; None if it is a mesh.

    Raises
    ------
    NotFoundError
        If it is text, and neither an id nor the path of a file.
    ParameterError
        If it is a signature.
    """
    if isinstance(query, Signature):
        raise ParameterError("a service ranks meshes and stored shapes, no signatures: send the mesh")
    return shape_id_of(query)


def known_shape(values: Json) -> AddedShape:
    """Return the shape of the response to an upload that was stored already."""
    shape = ShapeRecord.from_dict(values)
    return AddedShape.of(shape, is_new=False, ignored=values["ignored"], updated=values["updated"])


def finished(shape: AddedShape) -> JobStatus:
    """Return the job of an upload that needs none, because its shape is stored already."""
    return JobStatus(
        "", "shape", "succeeded", "done", 1.0, shape_id=shape.id, warnings=tuple(shape.warnings),
        ignored=shape.ignored, created_at=shape.created_at, started_at=shape.created_at, finished_at=shape.created_at,
    )  # fmt: skip


def ranking_of(status: JobStatus) -> Ranking:
    """Return the ranking of a query that succeeded; JobError if it has none."""
    if status.result is None:
        raise JobError(f"the ranking of job {status.id} is not stored any more")
    return status.result


def points(file: bytes) -> PointMap:
    """Return the match of a file of the format npz."""
    with np.load(io.BytesIO(file), allow_pickle=False) as arrays:
        return PointMap.from_dict(arrays)


def address(base_url: str | None) -> httpx.URL:
    """Return the URL of a service, by default that of UNBEND_URL; ServiceError if it is malformed or missing."""
    given = base_url if base_url is not None else os.environ.get("UNBEND_URL")
    if given is None:
        raise ServiceError("the address of the service is missing: give base_url, or set UNBEND_URL")
    try:
        return httpx.URL(given)
    except httpx.InvalidURL as error:
        raise ServiceError(f"{given} is not an address: {error}") from None


def headers(api_key: str | None) -> dict[str, str]:
    """Return the headers of every request; the key is that of UNBEND_API_KEY by default."""
    key = api_key if api_key is not None else os.environ.get("UNBEND_API_KEY")
    return {"Authorization": f"Bearer {key}"} if key else {}


def once() -> dict[str, str]:
    """Return a header with a new idempotency key: the service runs a request once, however often it arrives."""
    return {"Idempotency-Key": uuid.uuid4().hex}


def checked(response: httpx.Response) -> httpx.Response:
    """Return a successful response; raise the error that any other response reports.

    The error has the class of the problem's code, as if the library had raised it here, and the problem itself. It is
    a ServiceError if no class has the code, as for the page of a proxy.
    """
    if response.is_success:
        return response
    try:
        problem = response.json()
    except ValueError:
        problem = {}
    problem = problem if isinstance(problem, dict) else {}
    message = str(problem.get("detail") or f"{response.url} responded {response.status_code}")
    message = _PLACES.sub("", message)
    missing = NotFoundError.code if response.status_code == httpx.codes.NOT_FOUND else ""
    code = problem.get("code", missing)
    raise reported(
        ParameterError.code if code == _REFUSED else code,
        message,
        advice=str(problem.get("advice", "")),
        status=response.status_code,
        problem=problem,
    )


def outcome(status: JobStatus) -> JobStatus:
    """Return a job that succeeded; raise the error of any other job."""
    if status.state == "succeeded":
        return status
    error = status.error or JobFailure(JobError.code, f"the job was {status.state}")
    raise reported(error.code, error.message, advice=error.advice, unknown=JobError)


def unreachable(url: httpx.URL, error: Exception) -> ServiceError:
    """Return the error of a service at `url` that did not respond."""
    return ServiceError(f"the service at {url} could not be reached: {error}")
