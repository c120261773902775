"""Which format a download is in: `?format=`, or what the Accept header asks for (RFC 9110, section 12.5.1)."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Final, Literal, get_args
from urllib.parse import quote

from fastapi import HTTPException, Request, Response

from unbend.api.problems import MediaTypeError

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

_BYTES: Final = "application/octet-stream"
_ANY: Final = "*/*"
_QUALITY: Final = re.compile(r"0(\.\d{0,3})?|1(\.0{0,3})?")
"""A weight (RFC 9110, section 12.4.2)."""


def choose_format(
    request: Request, wanted: str | None, default: str, served: tuple[str, ...] = get_args(Format)
) -> str:
    """Return the format asked for, `default` where the caller leaves it open; 406 where we have none of those."""
    if wanted:
        return wanted
    asked = ", ".join(request.headers.getlist("accept"))
    if not asked.strip():
        return default
    ranges = _ranges(asked)
    names = dict.fromkeys((default, *served))  # among equals the first
    best = max(names, key=lambda name: _quality(ranges, name, default))
    if not _quality(ranges, best, default):
        raise HTTPException(406, f"formats served are {', '.join(MEDIA_TYPES[name] for name in names)}")
    return best


def _ranges(accept: str) -> dict[str, float]:
    """Return the weight of each media range of an Accept header. Parameters other than the weight are not looked at."""
    found: dict[str, float] = {}
    for part in accept.split(","):
        media_range, *parameters = (piece.strip().lower() for piece in part.split(";"))
        weights = [value.strip() for name, _, value in (each.partition("=") for each in parameters) if name == "q"]
        if not weights or _QUALITY.fullmatch(weights[0]):
            found[media_range] = float(weights[0]) if weights else 1.0
    return found


def _quality(ranges: Mapping[str, float], name: str, default: str) -> float:
    """Return the weight of a format: that of the most specific range it is in."""
    media_type = MEDIA_TYPES[name]
    within = [media_type, f"{media_type.partition('/')[0]}/*", _ANY]
    if name == default:  # which is what somebody gets who takes any bytes
        within.insert(1, _BYTES)
    return next((ranges[each] for each in within if each in ranges), 0.0)


def wants_job(request: Request) -> bool:
    """Return whether a caller would rather have a job than wait (RFC 7240, section 4.1)."""
    preferences = ",".join(request.headers.getlist("prefer")).lower().split(",")
    return any(each.partition(";")[0].strip() == "respond-async" for each in preferences)


def sends(media_type: str) -> Callable[[Request], None]:
    """Return a dependency that answers 415 to a body of any other type."""

    def check(request: Request) -> None:
        if request.headers.get("content-type", "").partition(";")[0].strip().lower() != media_type:
            raise MediaTypeError(media_type)

    return check


def file_headers(file_type: str, name: str) -> dict[str, str]:
    """Return the headers of a file to download."""
    plain = re.sub(r"[^\w.-]", "_", name, flags=re.ASCII) or "shape"
    return {
        "Content-Type": MEDIA_TYPES[file_type],
        "Content-Disposition": f'attachment; filename="{plain}.{file_type}"; '
        f"filename*=UTF-8''{quote(name, safe='')}.{file_type}",
        "Vary": "Accept",
    }


def file_response(data: bytes, file_type: str, name: str) -> Response:
    """Return a file to download."""
    return Response(data, headers=file_headers(file_type, name))
