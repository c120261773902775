"""Downloads: formats, conditional requests, ranges, and streaming from the store."""

from __future__ import annotations

import asyncio
import hashlib
import re
from collections.abc import AsyncIterator, Callable, Collection, Mapping
from functools import partial
from typing import Any, Final, Literal, get_args
from urllib.parse import quote

from fastapi import Request, Response
from starlette.datastructures import Headers
from starlette.responses import StreamingResponse

from unbend.api.middleware.methods import HEAD
from unbend.api.schema.problems import MediaTypeError, ProblemError
from unbend.errors import ObjectDamagedError
from unbend.mesh.formats import FORMATS, WrittenFormat
from unbend.results.shapes import ShapeRecord

_TAG: Final = re.compile(r'(W/)?"([\x21\x23-\x7e\x80-\xff]*)"')


def etag_of(record: ShapeRecord) -> str:
    """Return the entity tag of a shape's record, which differs after each change."""
    return f'"{record.id}.{record.revision}"'


def is_known(headers: Headers, tag: str) -> bool:
    """Return whether the If-None-Match header contains `tag` (RFC 9110, section 13.1.2)."""
    given = headers.get("if-none-match", "")
    return given.strip() == "*" or tag in {f'"{text}"' for _, text in _TAG.findall(given)}


def expected_revisions(headers: Headers, shape_id: str) -> Collection[int] | None:
    """Return the revisions of a shape that If-Match allows (RFC 9110, section 13.1.1); None for all."""
    given = headers.get("if-match")
    if given is None or given.strip() == "*":
        return None
    tags = (text.rpartition(".") for weak, text in _TAG.findall(given) if not weak)
    return frozenset(int(number) for of, _, number in tags if of == shape_id and re.fullmatch(r"\d{1,18}", number))


Format = Literal["json", WrittenFormat, "npz"]

TextureFormat = Literal["obj", "glb", "json", "npz"]

MEDIA_TYPES: Final[dict[str, str]] = {
    "json": "application/json",
    **FORMATS,
    "npz": "application/vnd.numpy.npz",
}

_BINARY: Final = {"type": "string", "format": "binary"}
_SCHEMAS: Final = {"json": {"schema": {"type": "object"}}}

_BYTES: Final = "application/octet-stream"
_ANY: Final = "*/*"
_QUALITY: Final = re.compile(r"0(\.\d{0,3})?|1(\.0{0,3})?")
"""A weight (RFC 9110, section 12.4.2)."""


def choose_format(
    request: Request, wanted: str | None, default: str, served: tuple[str, ...] = get_args(Format)
) -> str:
    """Return the requested format, `default` if none is requested; raise 406 if no requested format is available."""
    if wanted:
        return wanted
    accepted = ", ".join(request.headers.getlist("accept"))
    if not accepted.strip():
        return default
    ranges = _ranges(accepted)
    names = dict.fromkeys((default, *served))  # of equal weights, the first counts
    best = max(names, key=lambda name: _quality(ranges, name, default))
    if not _quality(ranges, best, default):
        raise ProblemError(
            406,
            f"the available formats are {', '.join(MEDIA_TYPES[name] for name in names)}",
            "Leave out the header Accept, or name one of these formats in it.",
        )
    return best


def _ranges(accept: str) -> dict[str, float]:
    """Return the weight of each media range of an Accept header. Other parameters are ignored."""
    found: dict[str, float] = {}
    for part in accept.split(","):
        media_range, *parameters = (piece.strip().lower() for piece in part.split(";"))
        weights = [value.strip() for name, _, value in (each.partition("=") for each in parameters) if name == "q"]
        if not weights or _QUALITY.fullmatch(weights[0]):
            found[media_range] = float(weights[0]) if weights else 1.0
    return found


def _quality(ranges: Mapping[str, float], name: str, default: str) -> float:
    """Return the weight of a format: the weight of the most specific range that matches."""
    media_type = MEDIA_TYPES[name]
    within = [media_type, f"{media_type.partition('/')[0]}/*", _ANY]
    if name == default:  # a client that accepts any bytes gets the default
        within.insert(1, _BYTES)
    return next((ranges[each] for each in within if each in ranges), 0.0)


def wants_job(request: Request) -> bool:
    """Return whether the caller prefers a job to a wait (RFC 7240, section 4.1)."""
    preferences = ",".join(request.headers.getlist("prefer")).lower().split(",")
    return any(each.partition(";")[0].strip() == "respond-async" for each in preferences)


def sends(media_type: str) -> Callable[[Request], None]:
    """Return a dependency that responds 415 to a body of any other type."""

    def check(request: Request) -> None:
        if request.headers.get("content-type", "").partition(";")[0].strip().lower() != media_type:
            raise MediaTypeError(media_type)

    return check


def file_content(*formats: str) -> dict[str, dict[str, Any]]:
    """Return the part of the OpenAPI document that describes a file in one of `formats`."""
    return {MEDIA_TYPES[name]: _SCHEMAS.get(name, {"schema": _BINARY}) for name in formats}


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
    """Return a response with a file to download."""
    return Response(data, headers=file_headers(file_type, name))


_RANGE: Final = re.compile(r"bytes=(\d{0,18})-(\d{0,18})")

Read = Callable[[int, int], bytes]
"""Returns the bytes of a file from an offset, at most a number of them."""


async def send_file(
    request: Request, read: Read, size: int, sha256: str, headers: dict[str, str], piece_bytes: int
) -> Response:
    """Return a response that streams a file, or the requested range, as fast as the client reads.

    At most `piece_bytes` of it are in memory at a time. If the file is removed meanwhile, or a whole file has other
    bytes than its hash, the connection closes before all bytes are sent.
    """
    tag = f'"{sha256}"'
    headers = headers | {"ETag": tag, "Accept-Ranges": "bytes"}
    if is_known(request.headers, tag):
        return Response(status_code=304, headers={"ETag": tag})
    part = _range(request, size, tag)
    if part is None:
        status, begin, end = 200, 0, size
    else:
        status, (begin, end) = 206, part
        if begin >= end:
            raise ProblemError(
                416,
                f"the range is outside the file, which has {size} bytes",
                f"Ask for bytes from 0 to {size - 1}, or leave out the header Range.",
                {"Content-Range": f"bytes */{size}"},
            )
        headers["Content-Range"] = f"bytes {begin}-{end - 1}/{size}"
    headers["Content-Length"] = str(end - begin)
    if request.scope.get(HEAD):
        return Response(status_code=status, headers=headers)
    pieces = _chunks(read, begin, end, piece_bytes, sha256 if part is None else None)
    first = await anext(pieces)  # an error still has its own response
    return StreamingResponse(_following(first, pieces), status, headers)


async def _chunks(read: Read, begin: int, end: int, piece_bytes: int, sha256: str | None) -> AsyncIterator[bytes]:
    """Yield a file in pieces. If its hash is given and wrong, raise ObjectDamagedError instead of the last piece."""
    found = hashlib.sha256()
    while begin < end:
        piece = await asyncio.to_thread(partial(read, begin, min(piece_bytes, end - begin)))
        begin += len(piece)
        if sha256 is not None:
            found.update(piece)
            if begin >= end and found.hexdigest() != sha256:
                raise ObjectDamagedError(f"the file of mesh {sha256} has other bytes than its hash")
        yield piece


async def _following(first: bytes, pieces: AsyncIterator[bytes]) -> AsyncIterator[bytes]:
    yield first
    async for piece in pieces:
        yield piece


def _range(request: Request, size: int, tag: str) -> tuple[int, int] | None:
    """Return the requested range of bytes; None for the whole file. A range outside the file has no bytes."""
    found = _RANGE.fullmatch(request.headers.get("range", "").strip())
    if not found or found[1] == found[2] == "" or request.headers.get("if-range", tag) != tag:
        return None  # for several ranges or other units, the whole file is a valid response
    if not found[1]:
        return max(0, size - int(found[2])), size if int(found[2]) else 0
    end = min(int(found[2]) + 1, size) if found[2] else size
    return int(found[1]), end
