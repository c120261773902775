"""Files as they were uploaded: sent in pieces from the store, whole or a range of them (RFC 9110, section 14)."""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncIterator, Callable
from functools import partial
from typing import Final

from fastapi import Request
from starlette.responses import Response, StreamingResponse

from unbend.api.conditions import is_known
from unbend.api.methods import HEAD

_PIECE: Final = 2**18
"""Bytes in memory for each client that is sent a file."""

_RANGE: Final = re.compile(r"bytes=(\d{0,18})-(\d{0,18})")

Read = Callable[[int, int], bytes]
"""Returns some bytes of a file, from an offset, so many at most."""


def send_file(request: Request, read: Read, size: int, sha256: str, headers: dict[str, str]) -> Response:
    """Return an answer that sends a file, or the range that is asked for, as the client takes it.

    Where the file goes meanwhile, the connection ends before the length that was announced.
    """
    tag = f'"{sha256}"'
    headers = headers | {"ETag": tag, "Accept-Ranges": "bytes"}
    if is_known(request.headers, tag):
        return Response(status_code=304, headers={"ETag": tag})
    asked = _range(request, size, tag)
    if asked is None:
        status, begin, end = 200, 0, size
    else:
        status, (begin, end) = 206, asked
        if begin >= end:
            return Response(status_code=416, headers={"Content-Range": f"bytes */{size}"})
        headers["Content-Range"] = f"bytes {begin}-{end - 1}/{size}"
    headers["Content-Length"] = str(end - begin)
    if request.scope.get(HEAD):
        return Response(status_code=status, headers=headers)
    return StreamingResponse(_pieces(read, begin, end), status, headers)


async def _pieces(read: Read, begin: int, end: int) -> AsyncIterator[bytes]:
    while begin < end:
        piece = await asyncio.to_thread(partial(read, begin, min(_PIECE, end - begin)))
        begin += len(piece)
        yield piece


def _range(request: Request, size: int, tag: str) -> tuple[int, int] | None:
    """Return the bytes that are asked for, an empty range where there are none such, and None for the whole file."""
    found = _RANGE.fullmatch(request.headers.get("range", "").strip())
    if not found or found[1] == found[2] == "" or request.headers.get("if-range", tag) != tag:
        return None  # of several ranges, or another unit, the whole file is an answer too
    if not found[1]:
        return max(0, size - int(found[2])), size if int(found[2]) else 0
    end = min(int(found[2]) + 1, size) if found[2] else size
    return int(found[1]), end
