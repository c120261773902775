"""Shapes: upload, list, look, change, remove, download."""

from __future__ import annotations

import asyncio
from functools import partial
from typing import Annotated, Any, Final, get_args

from fastapi import APIRouter, Depends, File, Form, Header, Query, Request, Response, UploadFile
from fastapi.responses import JSONResponse
from pydantic import WithJsonSchema
from sqlalchemy import Connection

from unbend.api.conditions import etag_of, expected_revisions, is_known
from unbend.api.fields import FILE, FILE_ENCODING, MetadataText, ParametersText, PolicyText, ShapeId
from unbend.api.files import send_file
from unbend.api.headers import DISPOSITION, ETAG, LOCATION
from unbend.api.links import job_links, next_page, shape_links
from unbend.api.models import Descriptors, Distances, Job, KnownShape, Shape, ShapeChanges, ShapePage
from unbend.api.negotiation import (
    MEDIA_TYPES,
    Format,
    TextureFormat,
    choose_format,
    file_headers,
    file_response,
    sends,
    wants_job,
)
from unbend.api.problems import problem_responses
from unbend.api.senders import IdempotencyKey, key_of, sender_of
from unbend.api.service import Service, ServiceDependency, service_of
from unbend.api.strictness import refuse_others
from unbend.api.uploads import name_of, parse_metadata, read_upload
from unbend.geodesics.distances import Update
from unbend.jobs.runner import Lane, WantedFile
from unbend.jobs.worker import StoredMesh, convert, flattened, geodesics_from, whole_form
from unbend.library import shapes as rows
from unbend.library.queue import Sender
from unbend.library.records import ShapeRecord
from unbend.library.shapes import IfKnown
from unbend.library.values import check_changes
from unbend.mesh.policy import MeshPolicy
from unbend.names import MAX_TEXT
from unbend.signature.export import export_signature
from unbend.signature.parameters import Parameters

router = APIRouter(prefix="/shapes", tags=["shapes"])

IfMatch = Annotated[
    str | None, Header(description="The ETag that the record had when it was read: 412 where it was changed since.")
]


_SMALL_FILE: Final = 2**21
"""Bytes of a mesh that is converted, or measured, in seconds."""

_AS_JOB: Final[dict[str, Any]] = {
    "model": Job,
    "description": "With `Prefer: respond-async`: the job that makes it, which `/jobs/{job_id}/file` then has.",
    "headers": LOCATION,
}

_FIELDS: Final = frozenset({"file", "name", "label", "metadata", "parameters", "policy", "if_known", "callback"})
"""The fields of an upload's form."""


def _file_responses(*formats: str) -> dict[int | str, dict[str, Any]]:
    described: dict[str, Any] = {
        "description": "The file.",
        "content": {MEDIA_TYPES[name]: {"schema": {"type": "string", "format": "binary"}} for name in formats},
        "headers": DISPOSITION,
    }
    described["content"]["application/json"] = {"schema": {"type": "object"}}
    return {200: described, 202: _AS_JOB, **problem_responses(404, 406, 422, 429, 504, 507)}


@router.post(
    "",
    status_code=202,
    response_model=Job,
    responses={
        200: {"model": KnownShape, "description": "Stored already.", "links": shape_links("$response.body#/id")},
        202: {"headers": LOCATION, "links": job_links("$response.body#/id")},
        **problem_responses(409, 415, 422, 429),
    },
    openapi_extra={"requestBody": {"content": {"multipart/form-data": {"encoding": FILE_ENCODING}}}},
    dependencies=[Depends(sends("multipart/form-data"))],
)
async def upload_shape(
    service: ServiceDependency,
    request: Request,
    file: Annotated[UploadFile, File(), WithJsonSchema(FILE)],
    name: Annotated[str, Form(max_length=MAX_TEXT, description="The file's own by default.")] = "",
    label: Annotated[
        str, Form(max_length=MAX_TEXT, description="The class it is known to belong to.", examples=["cat"])
    ] = "",
    metadata: Annotated[MetadataText, Form()] = None,
    parameters: Annotated[ParametersText, Form()] = None,
    policy: Annotated[PolicyText, Form()] = None,
    if_known: Annotated[
        IfKnown,
        Form(description="Whether a shape stored already keeps its name, label and metadata, or takes those sent."),
    ] = "keep",
    callback: Annotated[str, Form(max_length=2000, description="An address that is told when the job ends.")] = "",
    idempotency_key: IdempotencyKey = None,  # noqa: ARG001  `sender_of` reads it
) -> Response:
    """Store a mesh and have its signature computed.

    Answered at once with the job that computes it; the job is durable by then. Where the same bytes were stored
    with the same parameters and policy before, that shape is the answer, and `ignored` names what was sent with it
    now that it did not take.
    """
    refuse_others("body", await request.form(), _FIELDS)
    given = {"name": name, "label": label, "metadata": metadata}
    described = {
        "name": name_of(file, name), "label": label or None, "metadata": parse_metadata(metadata),
        "sent": [field for field, value in given.items() if value], "if_known": if_known,
    }  # fmt: skip
    upload = await read_upload(file, parameters, policy)
    sender, key = sender_of(request, "shape", upload, described, callback), key_of(request)
    answer = await service.runner.submit("shape", upload, described, sender, key.most_jobs if key else None)
    if isinstance(answer, rows.Known):
        return JSONResponse(KnownShape.of_known(answer).model_dump(mode="json"))
    job = Job.of(answer, await service.runner.position(answer))
    return JSONResponse(job.model_dump(mode="json"), 202, {"Location": f"/v1/jobs/{job.id}"})


@router.get(
    "",
    responses={
        200: {"links": shape_links("$response.body#/items/0/id") | next_page("list_shapes")},
        **problem_responses(422),
    },
)
def list_shapes(
    service: ServiceDependency,
    label: Annotated[str | None, Query(description="Only shapes of this class.")] = None,
    cursor: Annotated[
        str | None, Query(pattern=r"^[0-9]{1,18}$", description="`next_cursor` of the page before.")
    ] = None,
    sha256: Annotated[
        str | None, Query(pattern=r"^[0-9a-f]{64}$", description="Only shapes made from the file with this hash.")
    ] = None,
    limit: Annotated[int, Query(ge=1, le=500)] = 100,
) -> ShapePage:
    """List shapes in the order they were added."""
    page = service.library.page(label=label, sha256=sha256, cursor=cursor, limit=limit)
    return ShapePage(items=[Shape.of(record) for record in page.items], next_cursor=page.next_cursor)


@router.get(
    "/{shape_id}",
    response_model=Shape,
    responses={
        200: {"headers": ETAG, "links": shape_links("$response.body#/id", "get_shape")},
        304: {"description": "`If-None-Match` has its ETag: it was not changed."},
        **problem_responses(404, 422),
    },
)
async def get_shape(request: Request, shape_id: ShapeId) -> Response:
    """Return a shape's record."""
    look = partial(_record_text, shape_id=shape_id)
    text, tag = await service_of(request).library.store.fetch(look, ("record", shape_id))
    if is_known(request.headers, tag):
        return Response(status_code=304, headers={"ETag": tag})
    return Response(text, media_type="application/json", headers={"ETag": tag})


def _record_text(connection: Connection, shape_id: str) -> tuple[bytes, str]:
    """Return a record as it is answered, and its ETag, so that this is what is remembered."""
    record = rows.get_shape(connection, shape_id)
    return Shape.of(record).model_dump_json().encode(), etag_of(record)


@router.patch(
    "/{shape_id}",
    responses={
        200: {"headers": ETAG, "links": shape_links("$response.body#/id", "change_shape")},
        **problem_responses(404, 412, 415, 422),
    },
    dependencies=[Depends(sends("application/json"))],
)
async def change_shape(
    service: ServiceDependency,
    request: Request,
    response: Response,
    shape_id: ShapeId,
    changes: ShapeChanges,
    if_match: IfMatch = None,  # noqa: ARG001  for the document: all headers of this name count
) -> Shape:
    """Change a shape's name, label or metadata."""
    wanted = changes.model_dump(exclude_unset=True)
    check_changes(wanted)
    expected = expected_revisions(request.headers, shape_id)
    record = await service.runner.write(
        partial(rows.change_shape, shape_id=shape_id, changes=wanted, expected=expected)
    )
    response.headers["ETag"] = etag_of(record)
    return Shape.of(record)


@router.delete("/{shape_id}", status_code=204, responses=problem_responses(404, 412, 422))
async def remove_shape(
    service: ServiceDependency,
    request: Request,
    shape_id: ShapeId,
    if_match: IfMatch = None,  # noqa: ARG001
) -> None:
    """Remove a shape: its record, signature, descriptors and file."""
    expected = expected_revisions(request.headers, shape_id)
    await service.runner.write(partial(rows.remove_shape, shape_id=shape_id, expected=expected))


@router.get(
    "/{shape_id}/mesh",
    response_class=Response,
    responses=_file_responses(*MEDIA_TYPES)
    | {
        206: {"description": "The range that `Range` asks for, of the file as it was uploaded."},
        304: {"description": "`If-None-Match` has the ETag of the file as it was uploaded."},
        **problem_responses(416),
    },
)
async def get_mesh(
    service: ServiceDependency,
    request: Request,
    shape_id: ShapeId,
    format: Format | None = None,  # noqa: A002
) -> Response:
    """Download the mesh: byte for byte as it was uploaded, or as it was read, converted to `format`.

    Of the file as it was uploaded a single `Range` is answered, and its ETag stays as long as the shape.
    """
    record = await asyncio.to_thread(service.library.get, shape_id)
    stored = str(record.report["file_type"])
    wanted = choose_format(request, format, stored)
    if wanted == stored:
        read = partial(service.library.read_mesh, record.sha256)
        return send_file(request, read, record.size, record.sha256, file_headers(stored, record.name))
    if wants_job(request):
        return await _as_job(service, request, record, WantedFile("mesh", {"file_type": wanted}, wanted, record.name))
    data = await service.runner.call(convert, _stored(service, record), wanted, lane=_lane(record))
    return file_response(data, wanted, record.name)


@router.get("/{shape_id}/signature", response_class=Response, responses=_file_responses(*get_args(Format)))
async def get_signature(
    service: ServiceDependency,
    request: Request,
    shape_id: ShapeId,
    format: Format | None = None,  # noqa: A002
    whole: Annotated[bool, Query(description="Place every vertex, not only the samples.")] = False,
) -> Response:
    """Download the signature: everything as json (the default) or npz, or its surface as ply, obj, off or glb."""
    record = await asyncio.to_thread(service.library.get, shape_id)
    wanted = choose_format(request, format, "json")
    if whole and wants_job(request):
        arguments = {"shape_id": shape_id, "file_type": wanted}
        return await _as_job(
            service, request, record, WantedFile("signature", arguments, wanted, f"{record.name}-form")
        )
    signature = await asyncio.to_thread(service.library.signature, shape_id)
    if whole:
        data = await service.runner.call(whole_form, _stored(service, record), signature, wanted, lane="large")
    else:
        data = await asyncio.to_thread(export_signature, signature, wanted)
    return file_response(data, wanted, f"{record.name}-{'form' if whole else 'signature'}")


@router.get("/{shape_id}/flattening", response_class=Response, responses=_file_responses(*get_args(TextureFormat)))
async def get_flattening(
    service: ServiceDependency,
    request: Request,
    shape_id: ShapeId,
    format: TextureFormat | None = None,  # noqa: A002
) -> Response:
    """Download the mesh with texture coordinates: its canonical form in the plane, as obj (the default) or glb."""
    record = await asyncio.to_thread(service.library.get, shape_id)
    wanted = choose_format(request, format, "obj", get_args(TextureFormat))
    if wants_job(request):
        arguments = {"parameters": record.parameters, "file_type": wanted}
        return await _as_job(
            service, request, record, WantedFile("flattening", arguments, wanted, f"{record.name}-flattened")
        )
    parameters = Parameters.from_dict(record.parameters)
    data = await service.runner.call(flattened, _stored(service, record), parameters, wanted, lane="large")
    return file_response(data, wanted, f"{record.name}-flattened")


@router.get("/{shape_id}/descriptors", responses=problem_responses(404, 422))
def get_descriptors(service: ServiceDependency, shape_id: ShapeId) -> Descriptors:
    """Return the vectors that the measures compare."""
    signature = service.library.signature(shape_id)
    return Descriptors(descriptors={name: vector.tolist() for name, vector in signature.descriptors.items()})


@router.get(
    "/{shape_id}/geodesics",
    response_model=Distances,
    responses={202: _AS_JOB, **problem_responses(404, 409, 422, 429, 504, 507)},
)
async def get_geodesics(
    service: ServiceDependency,
    request: Request,
    shape_id: ShapeId,
    source: Annotated[int, Query(ge=0, le=2**31 - 1, description="A vertex of the file, counted from 0.")],
    target: Annotated[int | None, Query(ge=0, le=2**31 - 1, description="A vertex to find the path to.")] = None,
    update: Annotated[Update, Query(description="How fast marching crosses a triangle.")] = "spherical",
) -> Any:
    """Return the geodesic distances from one vertex to all, and the minimal path to `target`."""
    record = await asyncio.to_thread(service.library.get, shape_id)
    if wants_job(request):
        arguments = {"update": update, "source": source, "target": target}
        wanted = WantedFile("geodesics", arguments, "json", f"{record.name}-geodesics-{source}")
        return await _as_job(service, request, record, wanted)
    stored = _stored(service, record)
    found = await service.runner.call(geodesics_from, stored, update, source, target, lane=_lane(record))
    path: Any = found.path
    return Distances(source=source, distances=found.distances, target=target, path=path)


def _lane(record: ShapeRecord) -> Lane:
    return "large" if record.size > _SMALL_FILE else "small"


async def _as_job(service: Service, request: Request, record: ShapeRecord, wanted: WantedFile) -> Response:
    """Answer with the job that makes a file."""
    key = key_of(request)
    made = await service.runner.submit_file(record, wanted, Sender(key.id if key else None))
    job = Job.of(made, await service.runner.position(made))
    headers = {"Location": f"/v1/jobs/{job.id}", "Preference-Applied": "respond-async"}
    return JSONResponse(job.model_dump(mode="json"), 202, headers)


def _stored(service: Service, record: ShapeRecord) -> StoredMesh:
    policy = MeshPolicy.from_dict(record.policy)
    return StoredMesh(service.library.store.url, record.sha256, str(record.report["file_type"]), policy)
