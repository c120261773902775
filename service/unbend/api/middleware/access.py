"""Access control by API keys, scopes, hosts, origins and rate limits, before the body of a request is read."""

from __future__ import annotations

import asyncio
import re
from dataclasses import dataclass
from typing import Final, cast

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from unbend.api.context import CALLER, KEY, is_guarded, scope_of
from unbend.api.middleware.rate_limit import RateLimit
from unbend.api.schema.problems import respond
from unbend.api.server.addresses import is_address, is_loopback
from unbend.api.server.service import Service
from unbend.api.server.settings import Settings
from unbend.errors import (
    AccessError,
    HostError,
    KeyInvalidError,
    KeyRequiredError,
    OriginError,
    RateLimitError,
    ScopeError,
    StoreError,
)
from unbend.library.keys import KeyRecord

_PORT: Final = re.compile(r":\d*$")
_FORWARDED: Final = ("forwarded", "x-forwarded-for", "x-forwarded-host", "x-real-ip")
"""Headers in which a proxy names its client."""


@dataclass(frozen=True)
class Caller:
    """The caller of a request, checked against the keys of the library."""

    key: KeyRecord | None
    needs_key: bool
    address: str

    @property
    def name(self) -> str:
        """The name of the caller in logs."""
        return self.key.id if self.key and self.needs_key else "none" if self.needs_key else "open"


class Access:
    """ASGI middleware that admits a request, or responds 401, 403 or 429, or 503 if it cannot read the keys.

    Each request is checked against the keys in the store, so a new or revoked key takes effect with the next request. A
    library without keys is open to requests from this machine, and to other requests only if the settings allow it:
    revoking the last key of a public server does not open the server.
    """

    def __init__(self, app: ASGIApp, settings: Settings) -> None:
        self._app = app
        self._settings = settings
        self._rate = RateLimit(settings.requests_per_minute)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or respond with a problem."""
        if scope["type"] == "http" and is_guarded(scope["path"]):
            try:
                await self._admit(scope)
            except (AccessError, RateLimitError, StoreError) as error:
                await respond(error)(scope, receive, send)
                return
        await self._app(scope, receive, send)

    async def _admit(self, scope: Scope) -> None:
        headers = Headers(scope=scope)
        caller = await self._caller(scope, headers)
        scope[CALLER] = caller.name
        scope[KEY] = caller.key if caller.needs_key else None
        if wait := await self._take(scope, caller.address if caller.name in {"open", "none"} else caller.name):
            raise RateLimitError(f"more than {self._settings.requests_per_minute} requests a minute", wait)
        needed = scope_of(scope["method"], scope["path"])
        if not caller.needs_key:
            self._check_host(scope, headers)
            if needed == "write":
                self._check_origin(headers)
        elif caller.key is None:
            if "authorization" in headers:
                raise KeyInvalidError("the Authorization header contains no key of this library")
            raise KeyRequiredError("this request needs an API key")
        elif needed == "write" and caller.key.scope == "read":
            raise ScopeError("this key may only read")

    async def _take(self, scope: Scope, caller: str) -> int:
        service = cast("Service", scope["app"].state.service)
        if service.shared_rates and self._settings.requests_per_minute:
            return await asyncio.to_thread(service.shared_rates.take, caller)
        return self._rate.take(caller)

    async def _caller(self, scope: Scope, headers: Headers) -> Caller:
        service = cast("Service", scope["app"].state.service)
        token = _token(headers.get("authorization"))
        key, has_keys = await service.library.keys.find_async(token)
        client, _ = scope.get("client") or ("", None)
        if key and key.is_expired:
            key = None
        return Caller(key, has_keys or not (self._settings.open or _is_local(scope, headers)), client)

    def _check_host(self, scope: Scope, headers: Headers) -> None:
        """Refuse a request for an unknown host name: a website can resolve its own name to this server (DNS rebinding).

        An IP address and localhost cannot be such a name. With a key no check is needed: no website has the key.
        """
        host = _PORT.sub("", headers.get("host", "")).strip("[]").lower()
        known = not host or is_loopback(host) or is_address(host) or _is_in_process(scope)
        if not (known or {host, "*"} & set(self._settings.hosts)):
            raise HostError(f"{host[:100]!r} is not an allowed host of this service")

    def _check_origin(self, headers: Headers) -> None:
        """Refuse a write from a page of another site: CORS would only hide the response from that page."""
        origin = headers.get("origin")
        if origin is None or {origin, "*"} & set(self._settings.origins):
            return
        if origin.partition("://")[2] != headers.get("host"):
            raise OriginError("a page of another site may not write here")


def _is_local(scope: Scope, headers: Headers) -> bool:
    """Return whether a request came from this machine, without a proxy, and names this machine as its host.

    A proxy on this machine forwards the requests of others, and a page that uses DNS rebinding names another host.
    """
    if any(name in headers for name in _FORWARDED):
        return False
    if _is_in_process(scope):
        return True
    (here, _), (client, _) = scope.get("server") or ("", None), scope.get("client") or ("", None)
    return all(map(is_loopback, (here, client, _PORT.sub("", headers.get("host", "")).strip("[]"))))


def _is_in_process(scope: Scope) -> bool:
    """Return whether a client in this process made the request: its server address is a name, not an IP address."""
    here, _ = scope.get("server") or ("", None)
    return bool(here) and "/" not in here and not is_address(here)


def _token(given: str | None) -> str | None:
    scheme, _, token = (given or "").partition(" ")
    return token.strip() if scheme.lower() == "bearer" else None
