"""Which format a download is in: `?format=`, or what the Accept header asks for."""

from __future__ import annotations

import re
from typing import Final, Literal, get_args
from urllib.parse import quote

from fastapi import HTTPException, Request, Response

Format = Literal["json", "ply", "obj", "off", "glb", "npz"]

TextureFormat = Literal["obj", "glb", "json", "npz"]

MEDIA_TYPES: Final[dict[str, str]] = {
    "json": "application/json",
    "ply": "application/vnd.ply",
    "obj": "model/obj",
    "off": "model/vnd.off",
    "stl": "model/stl",
    "glb": "model/gltf-binary",
    "npz": "application/vnd.numpy.npz",
}


def choose_format(
    request: Request, wanted: str | None, default: str, served: tuple[str, ...] = get_args(Format)
) -> str:
    """Return the format asked for, `default` where the caller leaves it open; 406 where we have none of those."""
    if wanted:
        return wanted
    accepted = [part.split(";")[0].strip().lower() for part in request.headers.get("accept", "*/*").split(",")]
    if any(part in {"", "*/*", "application/*", "model/*", "application/octet-stream"} for part in accepted):
        return default
    formats: dict[str, str] = {MEDIA_TYPES[name]: name for name in (*served, default)}
    for part in accepted:
        if part in formats:
            return formats[part]
    raise HTTPException(406, f"formats served are {', '.join(formats)}")


def file_response(data: bytes, file_type: str, name: str) -> Response:
    """Return a file to download."""
    plain = re.sub(r"[^\w.-]", "_", name, flags=re.ASCII) or "shape"
    headers = {
        "Content-Disposition": f'attachment; filename="{plain}.{file_type}"; '
        f"filename*=UTF-8''{quote(name, safe='')}.{file_type}",
    }
    return Response(data, media_type=MEDIA_TYPES[file_type], headers=headers)
