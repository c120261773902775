"""Security headers of every response."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Iterable
from typing import Final

from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from unbend.api.schema.headers import headers_for

_PAGES: Final = frozenset({"/docs", "/docs/oauth2-redirect", "/redoc"})
# Swagger UI and ReDoc create style elements, ReDoc also a worker, and both show images from data URLs.
_PAGE_POLICY: Final = (
    "default-src 'none'; script-src 'self' {scripts}; style-src 'self' 'unsafe-inline'; img-src 'self' data:; "
    "font-src 'self' data:; connect-src 'self'; worker-src blob:; base-uri 'none'; frame-ancestors 'none'"
)
_INLINE_SCRIPT: Final = re.compile(rb"<script>(.*?)</script>", re.DOTALL)


class SecurityHeaders:
    """ASGI middleware that adds the headers of `headers_for` that a response lacks.

    The documentation pages also get a Content-Security-Policy that allows their inline scripts.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, and add headers to its response."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = [(name.lower().encode(), value.encode()) for name, value in headers_for(scope["path"]).items()]
        begun: list[Message] = []

        async def adding(message: Message) -> None:
            if message["type"] == "http.response.start":
                present = {name for name, _ in message["headers"]}
                message["headers"] = [*message["headers"], *(pair for pair in headers if pair[0] not in present)]
                if scope["path"] in _PAGES:
                    begun.append(message)  # sent later, because the policy contains hashes of the body's scripts
                    return
            elif begun:
                page = begun.pop()
                MutableHeaders(scope=page)["Content-Security-Policy"] = page_policy(message.get("body", b""))
                await send(page)
            await send(message)

        await self._app(scope, receive, adding)


def page_policy(page: bytes) -> str:
    """Return the content policy of a page, which allows its inline scripts by their hashes."""
    return _PAGE_POLICY.format(scripts=" ".join(_hashes(_INLINE_SCRIPT.findall(page))))


def _hashes(scripts: Iterable[bytes]) -> list[str]:
    digests = (hashlib.sha256(script).digest() for script in scripts)
    return [f"'sha256-{base64.b64encode(digest).decode()}'" for digest in digests]
