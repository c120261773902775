"""The web page: files that were built with the package, served at `/`."""

from __future__ import annotations

import gzip
import hashlib
import mimetypes
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final

from fastapi import APIRouter, HTTPException, Request, Response
from fastapi.responses import RedirectResponse

from unbend.api.routes.downloads import is_known

FOLDER: Final = Path(__file__).parent.parent / "page"
"""The files that `hatch_build.py` builds from service/web; absent if the package was installed without the page."""

router = APIRouter()

_POLICY: Final = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_FOREVER: Final = "public, max-age=31536000, immutable"  # the names of assets contain a hash of their content
_TYPES: Final = {".js": "text/javascript; charset=utf-8", ".css": "text/css; charset=utf-8", ".svg": "image/svg+xml"}
_RELATIVE: Final = b'="./assets/'


@dataclass(frozen=True)
class _Asset:
    data: bytes
    packed: bytes
    media_type: str


@router.get("/")
async def get_page(request: Request) -> Response:
    """Return the page, or lead to the documentation of the API if the package was built without the page."""
    page = _read_page()
    if page is None:
        return RedirectResponse("/docs")
    prefix: str = request.scope.get("root_path", "").rstrip("/")
    if prefix:  # a browser at /prefix, without a slash at the end, would look for ./assets beside the prefix
        page = page.replace(_RELATIVE, f'="{prefix}/assets/'.encode())
    tag = f'"{hashlib.sha256(page).hexdigest()[:32]}"'
    headers = {"Cache-Control": "no-cache", "ETag": tag, "Content-Security-Policy": _POLICY}
    if is_known(request.headers, tag):
        return Response(status_code=304, headers=headers)
    return Response(page, media_type="text/html; charset=utf-8", headers=headers)


@router.get("/assets/{name}")
async def get_asset(request: Request, name: str) -> Response:
    """Return a script, style sheet or picture of the page."""
    asset = _read_assets().get(name)
    if asset is None:
        raise HTTPException(404)
    headers = {"Cache-Control": _FOREVER, "Vary": "Accept-Encoding"}
    if "gzip" in request.headers.get("accept-encoding", ""):
        return Response(asset.packed, media_type=asset.media_type, headers=headers | {"Content-Encoding": "gzip"})
    return Response(asset.data, media_type=asset.media_type, headers=headers)


@cache
def _read_page() -> bytes | None:
    file = FOLDER / "index.html"
    return file.read_bytes() if file.is_file() else None


@cache
def _read_assets() -> dict[str, _Asset]:
    return {
        file.name: _Asset(data := file.read_bytes(), gzip.compress(data, mtime=0), _media_type(file))
        for file in (FOLDER / "assets").glob("*")
    }


def _media_type(file: Path) -> str:
    return _TYPES.get(file.suffix) or mimetypes.guess_type(file.name)[0] or "application/octet-stream"
