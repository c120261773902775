"""Queries: what a mesh is, and what is like it."""

from __future__ import annotations

import asyncio
import re
from typing import Annotated, Any, TypeVar

from fastapi import APIRouter, Header, Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from starlette.datastructures import FormData, UploadFile

from unbend.api.fields import (
    FEWER_PAIRS,
    FILE,
    FILE_ENCODING,
    ClassifierName,
    MeasureName,
    ParametersText,
    PolicyText,
)
from unbend.api.headers import LOCATION
from unbend.api.links import job_links, shape_links
from unbend.api.models import Job, Ranking, ShapeQuery
from unbend.api.problems import MediaTypeError, pointing_at, problem_responses
from unbend.api.routes.jobs import MAX_WAIT_SECONDS
from unbend.api.senders import IdempotencyKey, key_of, sender_of
from unbend.api.service import Service, ServiceDependency
from unbend.api.uploads import read_upload
from unbend.errors import BusyError
from unbend.library.ranking import Question
from unbend.library.records import JobRecord
from unbend.matching.classification import DEFAULT_CLASSIFIER, get_classifier
from unbend.matching.measures import DEFAULT_MEASURE, get_measure

router = APIRouter(prefix="/queries", tags=["queries"])

M = TypeVar("M", bound=BaseModel)


class FileQuery(BaseModel):
    """The fields beside the file of a query."""

    model_config = ConfigDict(extra="forbid", json_schema_extra=FEWER_PAIRS)

    measure: MeasureName = DEFAULT_MEASURE
    classifier: ClassifierName = Field(
        DEFAULT_CLASSIFIER, description="How distances from shapes become those from classes."
    )
    k: int = Field(10, ge=1, le=1000, description="Shapes in the answer; all classes are.")
    parameters: ParametersText = None
    policy: PolicyText = None
    callback: str = Field("", max_length=2000, description="An address that is told when the job ends.")


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
            "description": "The job that computes the answer; its `result` will be it.",
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
    prefer: Annotated[str | None, Header(description="`wait=10`: answer in place if done in 10 seconds.")] = None,
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


async def _by_shape(service: Service, asked: ShapeQuery) -> Response:
    _check(asked)
    ranking = await asyncio.to_thread(
        service.library.rank, asked.shape_id, measure=asked.measure, classifier=asked.classifier, k=asked.k
    )
    return JSONResponse(ranking.as_dict())


async def _by_file(service: Service, request: Request, form: FormData, wait: float) -> Response:
    file = form.get("file")
    if not isinstance(file, UploadFile):
        raise _invalid(("body", "file"), "a file is required")
    asked = _validated(FileQuery, {key: value for key, value in form.multi_items() if key != "file"})
    _check(asked)
    upload = await read_upload(file, asked.parameters, asked.policy)
    question = {"measure": asked.measure, "classifier": asked.classifier, "k": asked.k}
    sender, key = sender_of(request, "query", upload, question, asked.callback), key_of(request)
    answer = await service.runner.submit("query", upload, question, sender, key.most_jobs if key else None)
    if not isinstance(answer, JobRecord):
        raise TypeError("a query does not become a shape")
    record = await _waited(service, request, answer, wait)
    if not sender.idempotency and await request.is_disconnected():  # nobody knows of the job, or will ask for it
        await service.runner.cancel(record.id)
    if record.state == "succeeded":
        return JSONResponse(record.result)
    job = Job.of(record, await service.runner.position(record))
    return JSONResponse(job.model_dump(mode="json"), 202, {"Location": f"/v1/jobs/{job.id}"})


async def _waited(service: Service, request: Request, job: JobRecord, seconds: float) -> JobRecord:
    """Wait for a job if that is asked, and while the client is there.

    Where too many wait, the job is answer enough.
    """
    if not seconds:
        return job
    try:
        with service.waits.one():
            waiting = asyncio.create_task(service.runner.wait(job.id, seconds))
            gone = asyncio.create_task(_gone(request))
            await asyncio.wait([waiting, gone], return_when=asyncio.FIRST_COMPLETED)
            for task in (waiting, gone):
                if not task.done():
                    task.cancel()
            await asyncio.gather(waiting, gone, return_exceptions=True)
            return job if waiting.cancelled() else waiting.result()
    except BusyError:
        return job


async def _gone(request: Request) -> None:
    """Wait until the client has gone."""
    while (await request.receive())["type"] != "http.disconnect":
        pass


def _check(asked: ShapeQuery | FileQuery) -> None:
    """Refuse what the library would, by the name of the field, and before a job is made."""
    with pointing_at("body.measure"):
        get_measure(asked.measure)
    with pointing_at("body.classifier"):
        get_classifier(asked.classifier)
    with pointing_at("body.k"):
        Question.of(asked.measure, asked.classifier, asked.k)


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


def _invalid(location: tuple[str, ...], message: str) -> RequestValidationError:
    return RequestValidationError([{"type": "missing", "loc": location, "msg": message, "input": None}])
