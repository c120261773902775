"""Shapes: upload, list, read, change, remove, download."""

from __future__ import annotations

import asyncio
from functools import partial
from typing import Annotated, Any, Final, Literal, get_args

from fastapi import APIRouter, Depends, File, Form, Header, Query, Request, Response, UploadFile
from fastapi.responses import JSONResponse
from pydantic import WithJsonSchema

from unbend.api.routes.downloads import (
    MEDIA_TYPES,
    Format,
    TextureFormat,
    choose_format,
    etag_of,
    expected_revisions,
    file_content,
    file_headers,
    file_response,
    is_known,
    send_file,
    sends,
    wants_job,
)
from unbend.api.routes.jobs import accepted
from unbend.api.routes.senders import IdempotencyKey, key_of, sender_of
from unbend.api.routes.unknown_fields import form_of
from unbend.api.routes.uploads import default_name, parse_metadata, read_upload
from unbend.api.schema.fields import (
    CURSOR,
    FILE,
    FILE_ENCODING,
    SHA256,
    MetadataText,
    ParametersText,
    PolicyText,
    ShapeId,
)
from unbend.api.schema.headers import DISPOSITION, ETAG, LOCATION
from unbend.api.schema.links import job_links, next_page, shape_links
from unbend.api.schema.models import Descriptors, Distances, Job, KnownShape, Shape, ShapeChanges, ShapePage
from unbend.api.schema.problems import problem_responses
from unbend.api.server.service import Service, ServiceDependency, service_of
from unbend.geodesics.distances import Update
from unbend.jobs.runner import Lane
from unbend.jobs.worker import (
    StoredMesh,
    canonical_form_file,
    convert,
    flattened,
    geodesic_floats,
    geodesics_from,
)
from unbend.library.jobs import Sender
from unbend.library.requests import FileRequest, ShapeRequest
from unbend.names import MAX_TEXT
from unbend.results.shapes import AddedShape, IfKnown, ShapeOrder, ShapeRecord
from unbend.signature.export import export_signature

router = APIRouter(prefix="/shapes", tags=["shapes"])

IfMatch = Annotated[
    str | None, Header(description="The ETag of the record when it was read; 412 if the record has changed since.")
]


_SMALL_FILE: Final = 2**21
"""Largest file whose conversion or distances take only seconds."""

_AS_JOB: Final[dict[str, Any]] = {
    "model": Job,
    "description": "With `Prefer: respond-async`: the job that makes the file. Download it from `/jobs/{job_id}/file`.",
    "headers": LOCATION,
}

_FIELDS: Final = frozenset({"file", "name", "label", "metadata", "parameters", "policy", "if_known", "callback"})
"""The form fields of an upload."""


def _file_responses(*formats: str) -> dict[int | str, dict[str, Any]]:
    described = {"description": "The file.", "content": file_content(*formats), "headers": DISPOSITION}
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
    dependencies=[Depends(sends("multipart/form-data")), Depends(form_of(_FIELDS))],
)
async def upload_shape(
    service: ServiceDependency,
    request: Request,
    file: Annotated[UploadFile, File(), WithJsonSchema(FILE)],
    name: Annotated[str, Form(max_length=MAX_TEXT, description="Name of the shape; that of the file by default.")] = "",
    label: Annotated[str, Form(max_length=MAX_TEXT, description="The known class of the shape.")] = "",
    metadata: Annotated[MetadataText, Form()] = None,
    parameters: Annotated[ParametersText, Form()] = None,
    policy: Annotated[PolicyText, Form()] = None,
    if_known: Annotated[
        IfKnown,
        Form(description="Whether a stored shape keeps its name, label and metadata, or takes the new ones."),
    ] = "keep",
    callback: Annotated[str, Form(max_length=2000, description="A URL that is called when the job ends.")] = "",
    idempotency_key: IdempotencyKey = None,  # noqa: ARG001  `sender_of` reads it
) -> Response:
    """Store a mesh and compute its signature.

    The response is the durable job that computes the signature. If the same bytes are stored already, with the same
    parameters and policy, the response is the stored shape, and `ignored` names the fields that it did not take. There
    is no job then, so nothing is kept of its Idempotency-Key.
    """
    given = {"name": name or None, "label": label or None, "metadata": parse_metadata(metadata)}
    shape_request = ShapeRequest.of(default_name(file), given, if_known)
    upload = await read_upload(file, parameters, policy, in_memory=service.library.files.are_in_database)
    sender, key = sender_of(request, upload, shape_request, callback), key_of(request)
    found = await service.runner.submit_shape(upload, shape_request, sender, key.most_jobs if key else None)
    if isinstance(found, AddedShape):
        return JSONResponse(KnownShape.of_known(found).model_dump(mode="json"))
    return await accepted(service, found)


@router.get(
    "",
    responses={
        200: {"links": shape_links("$response.body#/items/0/id") | next_page("list_shapes")},
        **problem_responses(422),
    },
)
def list_shapes(
    service: ServiceDependency,
    label: Annotated[
        str | None, Query(description="Only shapes of this class. No filter finds shapes without a class.")
    ] = None,
    cursor: Annotated[str | None, Query(pattern=CURSOR, description="`next_cursor` of the page before.")] = None,
    sha256: Annotated[
        str | None, Query(pattern=SHA256, description="Only shapes made from the file with this hash.")
    ] = None,
    name: Annotated[
        str | None, Query(max_length=MAX_TEXT, description="Only shapes whose name contains this text, in either case.")
    ] = None,
    order: Annotated[ShapeOrder, Query(description="The shape that comes first.")] = "oldest",
    limit: Annotated[int, Query(ge=1, le=500)] = 100,
) -> ShapePage:
    """List shapes in the order of adding, or the newest first."""
    page = service.library.shapes.page(label=label, sha256=sha256, name=name, order=order, cursor=cursor, limit=limit)
    return ShapePage(items=[Shape.of(record) for record in page.items], next_cursor=page.next_cursor)


@router.get(
    "/{shape_id}",
    response_model=Shape,
    responses={
        200: {"headers": ETAG, "links": shape_links("$response.body#/id", "get_shape")},
        304: {"description": "`If-None-Match` contains its ETag: it has not changed."},
        **problem_responses(404, 422),
    },
)
async def get_shape(request: Request, shape_id: ShapeId) -> Response:
    """Return a shape's record."""
    text, tag = await service_of(request).library.shapes.render_async(shape_id, _render)
    if is_known(request.headers, tag):
        return Response(status_code=304, headers={"ETag": tag})
    return Response(text, media_type="application/json", headers={"ETag": tag})


def _render(record: ShapeRecord) -> tuple[bytes, str]:
    """Return the response for a shape, and its ETag; both are cached together."""
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
    if_match: IfMatch = None,  # noqa: ARG001  only for OpenAPI: a request may have several such headers
) -> Shape:
    """Change a shape's name, label or metadata."""
    wanted = changes.model_dump(exclude_unset=True)
    expected = expected_revisions(request.headers, shape_id)
    record = await service.library.shapes.change_async(shape_id, wanted, expected)
    response.headers["ETag"] = etag_of(record)
    return Shape.of(record)


@router.delete("/{shape_id}", status_code=204, responses=problem_responses(404, 412, 422))
async def remove_shape(
    service: ServiceDependency,
    request: Request,
    shape_id: ShapeId,
    if_match: IfMatch = None,  # noqa: ARG001
) -> Response:
    """Remove a shape: its record, signature, descriptors and file."""
    expected = expected_revisions(request.headers, shape_id)
    await service.library.shapes.remove_async(shape_id, expected)
    return Response(status_code=204)


@router.get(
    "/{shape_id}/mesh",
    response_class=Response,
    responses=_file_responses(*MEDIA_TYPES)
    | {
        206: {"description": "The requested range of the uploaded file."},
        304: {"description": "`If-None-Match` contains the ETag of the uploaded file."},
        **problem_responses(416),
    },
)
async def get_mesh(
    service: ServiceDependency,
    request: Request,
    shape_id: ShapeId,
    format: Format | None = None,  # noqa: A002
) -> Response:
    """Download the uploaded file byte for byte, or the mesh as it was read, converted to `format`.

    The uploaded file supports one `Range`. Its ETag never changes.
    """
    record = await asyncio.to_thread(service.library.shapes.get, shape_id)
    stored = record.file_type
    wanted = choose_format(request, format, stored)
    if wanted == stored:
        read = partial(service.library.shapes.read_file, record.sha256)
        headers = file_headers(stored, record.name)
        return await send_file(request, read, record.size, record.sha256, headers, service.library.files.piece_bytes)
    if wants_job(request):
        return await _respond_async(
            service, request, record, FileRequest("mesh", {"file_type": wanted}, wanted, record.name)
        )
    data = await service.runner.call(convert, stored_mesh(service, record), wanted, lane=lane_of(record))
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
    record = await asyncio.to_thread(service.library.shapes.get, shape_id)
    wanted = choose_format(request, format, "json")
    if whole and wants_job(request):
        arguments = {"shape_id": shape_id, "file_type": wanted}
        return await _respond_async(
            service, request, record, FileRequest("signature", arguments, wanted, f"{record.name}-form")
        )
    signature = await asyncio.to_thread(service.library.shapes.signature, shape_id)
    if whole:
        mesh = stored_mesh(service, record)
        data = await service.runner.call(canonical_form_file, mesh, signature, wanted, lane="large")
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
    record = await asyncio.to_thread(service.library.shapes.get, shape_id)
    wanted = choose_format(request, format, "obj", get_args(TextureFormat))
    if wants_job(request):
        arguments = {"parameters": record.parameters.as_dict(), "file_type": wanted}
        return await _respond_async(
            service, request, record, FileRequest("flattening", arguments, wanted, f"{record.name}-flattened")
        )
    data = await service.runner.call(flattened, stored_mesh(service, record), record.parameters, wanted, lane="large")
    return file_response(data, wanted, f"{record.name}-flattened")


@router.get("/{shape_id}/descriptors", responses=problem_responses(404, 422))
def get_descriptors(service: ServiceDependency, shape_id: ShapeId) -> Descriptors:
    """Return the vectors that the measures compare."""
    signature = service.library.shapes.signature(shape_id)
    return Descriptors(descriptors={name: vector.tolist() for name, vector in signature.descriptors.items()})


@router.get(
    "/{shape_id}/geodesics",
    response_model=Distances,
    responses={
        200: {"content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}}},
        202: _AS_JOB,
        **problem_responses(404, 409, 422, 429, 504, 507),
    },
)
async def get_geodesics(
    service: ServiceDependency,
    request: Request,
    shape_id: ShapeId,
    source: Annotated[int, Query(ge=0, le=2**31 - 1, description="A vertex of the file, counted from 0.")],
    target: Annotated[int | None, Query(ge=0, le=2**31 - 1, description="A vertex to find the path to.")] = None,
    update: Annotated[Update, Query(description="How fast marching crosses a triangle.")] = "spherical",
    distances: Annotated[bool, Query(description="Send the distances; false leaves only the path.")] = True,
    format: Annotated[  # noqa: A002
        Literal["json", "f32"],
        Query(description="`f32`: only the distances, as little-endian floats of 4 bytes, NaN for null."),
    ] = "json",
) -> Any:
    """Return the geodesic distances from one vertex to all, and the minimal path to `target`."""
    record = await asyncio.to_thread(service.library.shapes.get, shape_id)
    if wants_job(request):
        arguments = {"update": update, "source": source, "target": target}
        wanted = FileRequest("geodesics", arguments, "json", f"{record.name}-geodesics-{source}")
        return await _respond_async(service, request, record, wanted)
    stored, lane = stored_mesh(service, record), lane_of(record)
    if format == "f32":
        data = await service.runner.call(geodesic_floats, stored, update, source, lane=lane)
        return Response(data, media_type="application/octet-stream")
    found = await service.runner.call(geodesics_from, stored, update, source, target, distances, lane=lane)
    path: Any = found.path
    return Distances(source=source, distances=found.distances, target=target, path=path, length=found.length)


def lane_of(record: ShapeRecord) -> Lane:
    """Return the lane for calls that read a shape's file."""
    return "large" if record.size > _SMALL_FILE else "small"


async def _respond_async(service: Service, request: Request, record: ShapeRecord, wanted: FileRequest) -> Response:
    """Return the response with the job that makes a file."""
    key = key_of(request)
    sender, most_owned = Sender(key.id if key else None), key.most_jobs if key else None
    job = await service.runner.submit_file(record, wanted, sender, most_owned)
    return await accepted(service, job, {"Preference-Applied": "respond-async"})


def stored_mesh(service: Service, record: ShapeRecord) -> StoredMesh:
    """Return a shape's file for a worker."""
    return StoredMesh(service.library.address, record.sha256, record.file_type, record.policy)
