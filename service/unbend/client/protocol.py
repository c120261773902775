"""Requests and responses of the HTTP API, for both clients."""

from __future__ import annotations

import json
import os
import uuid
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypedDict

import httpx

from unbend.errors import JobError, NotFoundError, ParameterError, ServiceError, reported
from unbend.jsons import JsonObject
from unbend.mesh.policy import MeshPolicy
from unbend.mesh.sources import MeshSource, bytes_of
from unbend.names import MAX_TEXT, printable
from unbend.signature.parameters import Parameters

Json = dict[str, Any]

POLL_SECONDS: Final = 30.0
"""Longest time of a long poll."""

_REFUSED: Final = "request_invalid"
"""The code of a request that the service's own validation refuses."""

FINISHED: Final = frozenset({"succeeded", "failed", "cancelled"})

IN_PLACE: Final = {"Prefer": f"wait={POLL_SECONDS:.0f}"}
"""Header that requests the ranking of a query in the response itself, if the ranking is ready in time."""


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
    def of(cls, source: MeshSource) -> MeshFile:
        """Return the file of a mesh; see `bytes_of`."""
        file = bytes_of(source)
        if not file.name:
            return cls(file.data, "unnamed")
        name, title = printable(file.name), printable(Path(file.name).stem)[:MAX_TEXT]
        return cls(file.data, name, title if "\\" in name else None)  # servers read \ as a path separator


@dataclass(frozen=True)
class Details:
    """The description of an uploaded shape; fields that are None are not sent."""

    name: str | None = None
    label: str | None = None
    metadata: Mapping[str, Any] | None = None
    parameters: Parameters | Mapping[str, Any] | None = None
    policy: MeshPolicy | Mapping[str, Any] | None = None
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
    mesh: MeshFile,
    options: QueryOptions,
    parameters: Parameters | Mapping[str, Any] | None,
    policy: MeshPolicy | Mapping[str, Any] | None,
) -> Content:
    """Return the multipart form of a query by file."""
    return _content(mesh, vars(options) | {"parameters": parameters, "policy": policy})


def _content(mesh: MeshFile, fields: Mapping[str, object]) -> Content:
    data = {name: _text(value) for name, value in fields.items() if value is not None}
    return {"files": {"file": (mesh.name, mesh.data)}, "data": data}


def _text(value: object) -> str:
    """Return a field of a form as text: JSON for objects."""
    if isinstance(value, JsonObject):
        return value.to_json()
    return json.dumps(dict(value)) if isinstance(value, Mapping) else str(value)


def shape_query(shape_id: str, options: QueryOptions) -> Json:
    """Return the body of a query by a stored shape."""
    return {"shape_id": shape_id} | {name: value for name, value in vars(options).items() if value is not None}


def match(a: str, b: str, orientation: str | None, part: str | None, samples: int | None) -> Json:
    """Return the body of a match of two stored shapes."""
    given = {"orientation": orientation, "part": part, "samples": samples}
    return {"a": a, "b": b} | {name: value for name, value in given.items() if value is not None}


def overview(
    measure: str | None, parameters: Parameters | Mapping[str, Any] | None, distance: str | None = None
) -> dict[str, str]:
    """Return the parameters of a map or an evaluation."""
    text = None if parameters is None else _text(parameters)
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
    missing = NotFoundError.code if response.status_code == httpx.codes.NOT_FOUND else ""
    code = problem.get("code", missing)
    raise reported(
        ParameterError.code if code == _REFUSED else code,
        message,
        advice=str(problem.get("advice", "")),
        status=response.status_code,
        problem=problem,
    )


def outcome(job: Json) -> Json:
    """Return a job that succeeded; raise the error of any other job."""
    if job["state"] == "succeeded":
        return job
    error = job.get("error") or {"code": JobError.code, "message": f"the job was {job['state']}"}
    raise reported(error["code"], error["message"], advice=error.get("advice", ""))


def unreachable(url: httpx.URL, error: Exception) -> ServiceError:
    """Return the error of a service at `url` that did not respond."""
    return ServiceError(f"the service at {url} could not be reached: {error}")
