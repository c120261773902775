"""Requests and responses of the HTTP API, for both clients."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypedDict

import httpx

from unbend.errors import (
    JobError,
    MeshError,
    NotFoundError,
    ParameterError,
    ServiceError,
    StoreError,
    UnbendError,
    subclasses,
)
from unbend.names import MAX_TEXT, printable

Json = dict[str, Any]

POLL_SECONDS: Final = 30.0
"""Longest time of a long poll."""

FINISHED: Final = frozenset({"succeeded", "failed", "cancelled"})

IN_PLACE: Final = {"Prefer": f"wait={POLL_SECONDS:.0f}"}
"""Header that requests the ranking of a query in the response itself, if the ranking is ready in time."""

_JOB_ERRORS: Final[dict[str, type[UnbendError]]] = {
    kind.code: kind for base in (MeshError, ParameterError, StoreError, JobError) for kind in subclasses(base)
}
"""Classes of the errors that a job can have, by code."""


class Content(TypedDict, total=False):
    """The body of a multipart request, as httpx takes it."""

    files: dict[str, tuple[str, bytes]]
    data: dict[str, str]


@dataclass(frozen=True)
class MeshFile:
    """A mesh to send."""

    data: bytes
    name: str
    title: str | None = None
    """Name of the shape, if the service cannot derive it from the file name."""

    @classmethod
    def of(cls, source: bytes | str | Path) -> MeshFile:
        """Return a mesh from bytes or a path."""
        if isinstance(source, bytes):
            return cls(source, "unnamed")
        path = Path(source)
        name, title = printable(path.name), printable(path.stem)[:MAX_TEXT]
        return cls(path.read_bytes(), name, title if "\\" in name else None)  # servers read \ as a path separator


@dataclass(frozen=True)
class Details:
    """The description of an uploaded shape; fields that are None are not sent."""

    name: str | None = None
    label: str | None = None
    metadata: Mapping[str, Any] | None = None
    parameters: Mapping[str, Any] | None = None
    policy: Mapping[str, Any] | None = None
    if_known: str | None = None


def upload_content(mesh: MeshFile, details: Details) -> Content:
    """Return the multipart form of an upload."""
    return _content(mesh, vars(details) | {"name": details.name or mesh.title})


@dataclass(frozen=True)
class QueryOptions:
    """The options of a query; fields that are None have the service's defaults."""

    measure: str | None
    classifier: str | None
    k: int


def query_content(
    mesh: MeshFile, options: QueryOptions, parameters: Mapping[str, Any] | None, policy: Mapping[str, Any] | None
) -> Content:
    """Return the multipart form of a query by file."""
    return _content(mesh, vars(options) | {"parameters": parameters, "policy": policy})


def _content(mesh: MeshFile, fields: Mapping[str, object]) -> Content:
    data = {
        name: json.dumps(dict(value)) if isinstance(value, Mapping) else str(value)
        for name, value in fields.items()
        if value is not None
    }
    return {"files": {"file": (mesh.name, mesh.data)}, "data": data}


def shape_query(shape_id: str, options: QueryOptions) -> Json:
    """Return the body of a query by a stored shape."""
    return {"shape_id": shape_id} | {name: value for name, value in vars(options).items() if value is not None}


def match(a: str, b: str, orientation: str | None, part: str | None, samples: int | None) -> Json:
    """Return the body of a match of two stored shapes."""
    given = {"orientation": orientation, "part": part, "samples": samples}
    return {"a": a, "b": b} | {name: value for name, value in given.items() if value is not None}


def overview(measure: str | None, parameters: Mapping[str, Any] | None, distance: str | None = None) -> dict[str, str]:
    """Return the parameters of a map or an evaluation."""
    text = None if parameters is None else json.dumps(dict(parameters))
    given = {"measure": measure, "parameters": text, "distance": distance}
    return {name: value for name, value in given.items() if value is not None}


def page(label: str | None, cursor: str | None) -> dict[str, str]:
    """Return the parameters of a page of shapes."""
    return {key: value for key, value in (("label", label), ("cursor", cursor)) if value is not None}


def job_path(job_id: str) -> str:
    """Return the path of a job."""
    return f"/v1/jobs/{job_id}"


def file_path(job_id: str) -> str:
    """Return the path of the file that a job made."""
    return f"{job_path(job_id)}/file"


def events_path(job_id: str) -> str:
    """Return the path of a job's events."""
    return f"{job_path(job_id)}/events"


def submitted(response: httpx.Response) -> tuple[Json, Json | None]:
    """Return the job of an upload, and the shape if it was stored already."""
    body = dict(response.json())
    if response.status_code == httpx.codes.OK:
        return {"id": "", "kind": "shape", "state": "succeeded", "shape_id": body["id"]}, body
    return body, None


def address(base_url: str) -> httpx.URL:
    """Return the URL of a service; ServiceError if it is malformed."""
    try:
        return httpx.URL(base_url)
    except httpx.InvalidURL as error:
        raise ServiceError(f"{base_url} is not an address: {error}") from None


def headers(api_key: str | None) -> dict[str, str]:
    """Return the headers of every request."""
    return {} if api_key is None else {"Authorization": f"Bearer {api_key}"}


def checked(response: httpx.Response) -> httpx.Response:
    """Return a successful response; raise an error for any other response.

    Raises
    ------
    NotFoundError
        On 404.
    ServiceError
        On any other error, with the problem document.
    """
    if response.is_success:
        return response
    try:
        problem = response.json()
    except ValueError:
        problem = {}
    problem = problem if isinstance(problem, dict) else {}
    message = str(problem.get("detail") or f"the service responded {response.status_code}")
    if response.status_code == httpx.codes.NOT_FOUND:
        raise NotFoundError(message)
    raise ServiceError(message, status=response.status_code, problem=problem)


def retry_after(response: httpx.Response) -> float | None:
    """Return the seconds to wait if the service is at a limit; None for any other response."""
    busy = response.status_code == httpx.codes.SERVICE_UNAVAILABLE and "Retry-After" in response.headers
    if response.status_code != httpx.codes.TOO_MANY_REQUESTS and not busy:
        return None
    value = response.headers.get("Retry-After", "1")
    return float(value) if value.isdecimal() else 1.0


def outcome(job: Json) -> Json:
    """Return a job that succeeded; raise the error of any other job."""
    if job["state"] == "succeeded":
        return job
    error = job.get("error") or {"code": "job_failed", "message": f"the job was {job['state']}"}
    raise _JOB_ERRORS.get(error["code"], JobError)(error["message"])


def unreachable(error: Exception) -> ServiceError:
    """Return the error of a service that did not respond."""
    return ServiceError(f"the service could not be reached: {error}")
