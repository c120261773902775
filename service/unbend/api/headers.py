"""Headers of every answer that tell browsers what not to do with it."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Iterable
from typing import Final

from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from unbend.api.requests import PREFIX

_ALWAYS: Final = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "X-Frame-Options": "DENY",
    "Content-Security-Policy": "default-src 'none'; frame-ancestors 'none'",
}
ETAG: Final = {
    "ETag": {"description": "Another one after each change.", "required": True, "schema": {"type": "string"}}
}
LOCATION: Final = {
    "Location": {
        "description": "Where the job is.",
        "required": True,
        "schema": {"type": "string", "format": "uri-reference"},
    }
}
DISPOSITION: Final = {
    "Content-Disposition": {"description": "The file's name.", "required": True, "schema": {"type": "string"}},
    "Vary": {"description": "Accept chooses the format.", "required": True, "schema": {"type": "string"}},
}
"""How OpenAPI documents the headers of a record and of a file; and where the job is that an answer tells of."""

_PAGES: Final = frozenset({"/docs", "/docs/oauth2-redirect", "/redoc"})
# Swagger UI and ReDoc make style elements of their own as they run, ReDoc a worker too, and draw images from data.
_PAGE_POLICY: Final = (
    "default-src 'none'; script-src 'self' {scripts}; style-src 'self' 'unsafe-inline'; img-src 'self' data:; "
    "font-src 'self' data:; connect-src 'self'; worker-src blob:; base-uri 'none'; frame-ancestors 'none'"
)
_INLINE_SCRIPT: Final = re.compile(rb"<script>(.*?)</script>", re.DOTALL)


def headers_for(path: str) -> dict[str, str]:
    """Return the headers of an answer to a call of `path`: what the API tells is for its caller only."""
    return _ALWAYS | ({"Cache-Control": "no-store"} if path.startswith(f"{PREFIX}/") else {})


class SecurityHeaders:
    """ASGI middleware that adds `headers_for` to every answer, and to the pages of the API a policy of their own."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, and its answer back with headers."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = [(name.lower().encode(), value.encode()) for name, value in headers_for(scope["path"]).items()]
        begun: list[Message] = []

        async def adding(message: Message) -> None:
            if message["type"] == "http.response.start":
                there = {name for name, _ in message["headers"]}
                message["headers"] = [*message["headers"], *(pair for pair in headers if pair[0] not in there)]
                if scope["path"] in _PAGES:
                    begun.append(message)  # until the page is seen: it is sent as one
                    return
            elif begun:
                page = begun.pop()
                MutableHeaders(scope=page)["Content-Security-Policy"] = page_policy(message.get("body", b""))
                await send(page)
            await send(message)

        await self._app(scope, receive, adding)


def page_policy(page: bytes) -> str:
    """Return the policy of a page that is ours throughout: of inline scripts, those that are in it by their hashes."""
    return _PAGE_POLICY.format(scripts=" ".join(_hashes(_INLINE_SCRIPT.findall(page))))


def _hashes(scripts: Iterable[bytes]) -> list[str]:
    digests = (hashlib.sha256(script).digest() for script in scripts)
    return [f"'sha256-{base64.b64encode(digest).decode()}'" for digest in digests]
