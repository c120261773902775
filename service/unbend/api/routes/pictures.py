"""Pictures of shapes, and their surfaces with signatures for viewers."""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import Awaitable, Callable
from typing import Annotated, Any, Final

from fastapi import APIRouter, Depends, File, Form, Query, Request, Response, UploadFile
from pydantic import WithJsonSchema

from unbend.api.routes.downloads import is_known, sends
from unbend.api.routes.shapes import lane_of, stored_mesh
from unbend.api.routes.unknown_fields import form_of
from unbend.api.routes.uploads import read_upload
from unbend.api.schema.fields import FILE, FILE_ENCODING, ParametersText, PolicyText, ShapeId
from unbend.api.schema.headers import ETAG
from unbend.api.schema.problems import problem_responses
from unbend.api.server.service import ServiceDependency
from unbend.jobs.worker import draw_picture, viewer_file, viewer_file_of
from unbend.render.colours import ThemeName
from unbend.render.display import MOST_FACES
from unbend.render.request import Format, PictureRequest, Subject
from unbend.results.shapes import ShapeRecord

router = APIRouter(tags=["shapes"])

_DRAWING_VERSION: Final = "1"
"""A part of each ETag. Change it when the same shape and options give other bytes."""

_VALIDATED: Final = {"Cache-Control": "private, no-cache"}
"""A browser may keep the bytes, and asks each time whether they are still right."""


def _responses(*media_types: str) -> dict[int | str, dict[str, Any]]:
    content = {name: {"schema": {"type": "string", "format": "binary"}} for name in media_types}
    return {
        200: {"description": "The file.", "content": content, "headers": ETAG},
        304: {"description": "`If-None-Match` contains its ETag: it has not changed."},
        **problem_responses(404, 422, 429, 504, 507),
    }


@router.get("/shapes/{shape_id}/thumbnail", response_class=Response, responses=_responses("image/webp", "image/png"))
async def get_thumbnail(
    service: ServiceDependency,
    request: Request,
    shape_id: ShapeId,
    subject: Annotated[Subject, Query(description="What is drawn; `both` side by side.")] = "surface",
    width: Annotated[int, Query(ge=16, le=2048, description="In pixels.")] = 256,
    height: Annotated[int, Query(ge=16, le=2048, description="In pixels.")] = 256,
    theme: Annotated[ThemeName, Query(description="The background.")] = "transparent",
    format: Annotated[Format, Query()] = "webp",  # noqa: A002
) -> Response:
    """Return a picture of a shape's surface, or of its signature."""
    record = await asyncio.to_thread(service.library.shapes.get, shape_id)
    wanted = PictureRequest(subject=subject, width=width, height=height, theme=theme, format=format)

    async def draw() -> bytes:
        signature = None
        if subject != "surface":
            signature = await asyncio.to_thread(service.library.shapes.signature, shape_id)
        return await service.runner.call(
            draw_picture, stored_mesh(service, record), signature, wanted, lane=lane_of(record)
        )

    return await _cached(service, request, record, ("thumbnail", wanted), f"image/{format}", draw)


@router.get("/shapes/{shape_id}/view", response_class=Response, responses=_responses("model/gltf-binary"))
async def get_view(
    service: ServiceDependency,
    request: Request,
    shape_id: ShapeId,
    faces: Annotated[
        int, Query(ge=100, le=1_000_000, description="A surface of more faces is simplified to about this number.")
    ] = MOST_FACES,
) -> Response:
    """Return a shape's surface and signature for a viewer, as one glb file.

    Beside its position, each vertex has three attributes: `_FORM` is its place in the signature (the first three
    dimensions, in the unit and the orientation of the surface), `_MORE` the dimensions 4 to 6 if there are any, and
    `_VERTEX` its number in the uploaded file. The member `extras` of the asset has the `centre` of the file that is
    the origin here, the `dimensions` of the signature, the axis that points `up`, and the numbers of `faces` here and
    in the file (`full_faces`).
    """
    record = await asyncio.to_thread(service.library.shapes.get, shape_id)

    async def make() -> bytes:
        signature = await asyncio.to_thread(service.library.shapes.signature, shape_id)
        return await service.runner.call(
            viewer_file, stored_mesh(service, record), signature, faces, lane=lane_of(record)
        )

    return await _cached(service, request, record, ("view", faces), "model/gltf-binary", make)


@router.post(
    "/views",
    response_class=Response,
    responses={
        200: {
            "description": "The file.",
            "content": {"model/gltf-binary": {"schema": {"type": "string", "format": "binary"}}},
        },
        **problem_responses(415, 422, 429, 504, 507),
    },
    openapi_extra={"requestBody": {"content": {"multipart/form-data": {"encoding": FILE_ENCODING}}}},
    dependencies=[Depends(sends("multipart/form-data")), Depends(form_of(frozenset({"file", "parameters", "policy"})))],
)
async def view_file(
    service: ServiceDependency,
    file: Annotated[UploadFile, File(), WithJsonSchema(FILE)],
    parameters: Annotated[ParametersText, Form()] = None,
    policy: Annotated[PolicyText, Form()] = None,
) -> Response:
    """Return the view of a mesh that is not stored: the glb file that `GET /shapes/{shape_id}/view` describes."""
    upload = await read_upload(file, parameters, policy)
    data = await service.runner.call(
        viewer_file_of, upload.read(), upload.file_type, upload.parameters, upload.policy, service.settings.limits.mesh,
        MOST_FACES, lane="large",
    )  # fmt: skip
    return Response(data, media_type="model/gltf-binary")


async def _cached(
    service: ServiceDependency,
    request: Request,
    record: ShapeRecord,
    options: tuple[object, ...],
    media_type: str,
    make: Callable[[], Awaitable[bytes]],
) -> Response:
    """Return 304 if the client has the bytes, otherwise cached or new ones.

    The bytes depend on the file and on how it was read and computed, but not on the name, label or metadata.
    """
    key = (record.id, record.sha256, record.version, options)
    digest = hashlib.sha256(repr((_DRAWING_VERSION, key)).encode()).hexdigest()
    headers = {"ETag": f'"{digest[:32]}"', **_VALIDATED}
    if is_known(request.headers, headers["ETag"]):
        return Response(status_code=304, headers=headers)
    data = service.pictures.get(key)
    if data is None:
        data = await make()
        service.pictures.put(key, data)
    return Response(data, media_type=media_type, headers=headers)
