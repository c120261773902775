"""Queries: the classes and shapes nearest to a mesh."""

from __future__ import annotations

import asyncio
import re
from typing import Annotated, Any, Final, TypeVar, cast

from fastapi import APIRouter, Header, Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from starlette.datastructures import FormData, UploadFile

from unbend.api.routes.jobs import MAX_WAIT_SECONDS, accepted
from unbend.api.routes.senders import IdempotencyKey, key_of, sender_of
from unbend.api.routes.unknown_fields import check_form
from unbend.api.routes.uploads import parse_metadata, read_upload
from unbend.api.schema.fields import (
    EXACT,
    FILE,
    FILE_ENCODING,
    QUERY_CONDITIONS,
    ClassifierName,
    FilterText,
    MeasureName,
    ParametersText,
    PolicyText,
)
from unbend.api.schema.headers import LOCATION
from unbend.api.schema.links import job_links, shape_links
from unbend.api.schema.models import Job, Ranking, ShapeQuery
from unbend.api.schema.problems import MediaTypeError, problem_responses
from unbend.api.server.service import Service, ServiceDependency
from unbend.errors import BusyError, ParameterError
from unbend.library.records import JobRecord
from unbend.library.requests import QueryRequest
from unbend.matching.classification import DEFAULT_CLASSIFIER
from unbend.matching.measures import DEFAULT_MEASURE
from unbend.names import MAX_TEXT
from unbend.results.rankings import DEFAULT_K

router = APIRouter(prefix="/queries", tags=["queries"])

M = TypeVar("M", bound=BaseModel)


class FileQuery(BaseModel):
    """The form fields of a query, except its file."""

    model_config = ConfigDict(extra="forbid", json_schema_extra=QUERY_CONDITIONS)

    measure: MeasureName = DEFAULT_MEASURE
    classifier: ClassifierName = Field(
        DEFAULT_CLASSIFIER, description="The rule that turns distances from shapes into distances from classes."
    )
    k: int = Field(DEFAULT_K, ge=1, le=1000, description="Number of shapes in the ranking. All classes are in it.")
    exact: bool = Field(False, description=EXACT)
    label: str | None = Field(None, min_length=1, max_length=MAX_TEXT, description="Only shapes of this class.")
    metadata: FilterText = None
    parameters: ParametersText = None
    policy: PolicyText = None
    callback: str = Field("", max_length=2000, description="A URL that is called when the job ends.")


_FORM: Final = frozenset({"file", *FileQuery.model_fields})
_FILE_SCHEMA = FileQuery.model_json_schema()
_BODY = {
    "requestBody": {
        "required": True,
        "content": {
            "multipart/form-data": {
                "schema": _FILE_SCHEMA
                | {"properties": _FILE_SCHEMA["properties"] | {"file": FILE}, "required": ["file"]},
                "encoding": FILE_ENCODING,
            },
            "application/json": {"schema": ShapeQuery.model_json_schema()},
        },
    }
}


@router.post(
    "",
    response_model=Ranking,
    responses={
        200: {"links": shape_links("$response.body#/shapes/0/id")},
        202: {
            "model": Job,
            "description": "The job that computes the ranking, which becomes the job's `result`.",
            "headers": LOCATION,
            "links": job_links("$response.body#/id"),
        },
        **problem_responses(404, 409, 415, 422, 429),
    },
    openapi_extra=_BODY,
)
async def query(
    service: ServiceDependency,
    request: Request,
    prefer: Annotated[
        str | None, Header(description="`wait=10`: respond with the ranking if it is done within 10 seconds.")
    ] = None,
    idempotency_key: IdempotencyKey = None,  # noqa: ARG001  `sender_of` reads it
) -> Response:
    """Rank the library's classes and shapes by their distance from a mesh, or from a stored shape.

    Send `multipart/form-data` with a `file`, or JSON with a `shape_id`. A file becomes a job, and is not stored
    in the library.
    """
    kind = request.headers.get("content-type", "").split(";")[0].strip().lower()
    if kind == "application/json":
        return await _by_shape(service, _validated(ShapeQuery, await request.body()))
    if kind == "multipart/form-data":
        async with request.form(max_files=1, max_fields=10) as form:
            return await _by_file(service, request, form, _wait_seconds(prefer))
    raise MediaTypeError("multipart/form-data with a file", "application/json with a shape_id")


async def _by_shape(service: Service, given: ShapeQuery) -> Response:
    ranking = await asyncio.to_thread(service.library.search.rank, given.shape_id, _request(given))
    return JSONResponse(ranking.as_dict())


async def _by_file(service: Service, request: Request, form: FormData, wait: float) -> Response:
    check_form(form, _FORM)
    file = cast("UploadFile", form["file"])
    given = _validated(FileQuery, {key: value for key, value in form.multi_items() if key != "file"})
    query_request = _request(given)
    in_memory = service.library.files.are_in_database
    upload = await read_upload(file, given.parameters, given.policy, in_memory=in_memory)
    sender, key = sender_of(request, upload, query_request, given.callback), key_of(request)
    job = await service.runner.submit_query(upload, query_request, sender, key.most_jobs if key else None)
    record = await _waited(service, request, job, wait)
    if not sender.idempotency and await request.is_disconnected():  # no client has the id of the job
        await service.runner.cancel(record.id)
    if record.state == "succeeded":
        return JSONResponse(record.result)
    return await accepted(service, record)


async def _waited(service: Service, request: Request, job: JobRecord, seconds: float) -> JobRecord:
    """Wait up to `seconds` for a job, while the client is connected; do not wait if too many requests wait."""
    if not seconds:
        return job
    try:
        with service.waits.one():
            waiting = asyncio.create_task(service.runner.wait(job.id, seconds))
            disconnected = asyncio.create_task(_disconnected(request))
            await asyncio.wait([waiting, disconnected], return_when=asyncio.FIRST_COMPLETED)
            for task in (waiting, disconnected):
                if not task.done():
                    task.cancel()
            await asyncio.gather(waiting, disconnected, return_exceptions=True)
            return job if waiting.cancelled() else waiting.result()
    except BusyError:
        return job


async def _disconnected(request: Request) -> None:
    """Wait until the client disconnects."""
    while (await request.receive())["type"] != "http.disconnect":
        pass


def _request(given: ShapeQuery | FileQuery) -> QueryRequest:
    """Return the validated query; ParameterError names the field of the body."""
    try:
        metadata = given.metadata if isinstance(given, ShapeQuery) else parse_metadata(given.metadata)
        return QueryRequest(given.measure, given.classifier, given.k, given.exact, given.label, metadata or {})
    except ParameterError as error:
        error.field = f"body.{error.field}"
        raise


def _wait_seconds(prefer: str | None) -> float:
    found = re.search(r"\bwait\s*=\s*(\d{1,6})\b", prefer or "")
    return min(float(found.group(1)), MAX_WAIT_SECONDS) if found else 0.0


def _validated(model: type[M], values: bytes | dict[str, Any]) -> M:
    try:
        return model.model_validate_json(values) if isinstance(values, bytes) else model.model_validate(values)
    except ValidationError as error:
        details = [
            {**item, "loc": ("body", *item["loc"])} for item in error.errors(include_url=False, include_input=False)
        ]
        raise RequestValidationError(details) from None
