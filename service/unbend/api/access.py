"""Who may call: API keys and their scopes, and how often. Before anything of the request's body is read."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import partial
from typing import Final, Literal, cast

from sqlalchemy import Connection
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from unbend.api.addresses import is_address, is_loopback
from unbend.api.problems import respond
from unbend.api.rate import RateLimit
from unbend.api.requests import PREFIX
from unbend.api.service import Service
from unbend.api.settings import Settings
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
from unbend.library.keys import KeyRecord, find_key, has_keys

CALLER: Final = "unbend.caller"
"""Where in an ASGI scope it stands who calls: a key's id, "open" where none is needed, or "none"."""

KEY: Final = "unbend.key"
"""Where in an ASGI scope the KeyRecord stands that a call came with, if the service asks for keys."""

_FREE: Final = frozenset({f"{PREFIX}/livez", f"{PREFIX}/readyz"})
_PORT: Final = re.compile(r":\d*$")
_FORWARDED: Final = ("forwarded", "x-forwarded-for", "x-forwarded-host", "x-real-ip")
"""Headers by which a proxy tells for whom it calls."""

_READING: Final = frozenset({"GET", "HEAD", "OPTIONS"})


def is_guarded(path: str) -> bool:
    """Return whether a call of `path` needs a key where the service asks for keys."""
    return path.startswith(f"{PREFIX}/") and path not in _FREE


def scope_of(method: str, path: str) -> Literal["read", "write"]:
    """Return what a key must allow for this call. A query stores no shape, so it reads."""
    return "read" if method in _READING or (method, path) == ("POST", f"{PREFIX}/queries") else "write"


@dataclass(frozen=True)
class Caller:
    """What a request says of who sends it, checked against the library."""

    key: KeyRecord | None
    closed: bool
    address: str

    @property
    def name(self) -> str:
        """What the log calls it."""
        return self.key.id if self.key and self.closed else "none" if self.closed else "open"


class Access:
    """ASGI middleware that lets a call through or answers 401, 403 or 429, or 503 where keys cannot be looked up.

    Keys are looked up in the store for each call, so that one made or revoked counts from the next call on. A library
    without keys is open to calls from this machine, and to others only if the settings say so: revoking the last key
    of a server that others can reach does not open it.
    """

    def __init__(self, app: ASGIApp, settings: Settings) -> None:
        self._app = app
        self._settings = settings
        self._rate = RateLimit(settings.requests_per_minute)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or answer why not."""
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
        scope[KEY] = caller.key if caller.closed else None
        if wait := self._rate.take(caller.address if caller.name in {"open", "none"} else caller.name):
            raise RateLimitError(f"more than {self._settings.requests_per_minute} calls a minute", wait)
        needed = scope_of(scope["method"], scope["path"])
        if not caller.closed:
            self._check_host(scope, headers)
            if needed == "write":
                self._check_origin(headers)
        elif caller.key is None:
            if "authorization" in headers:
                raise KeyInvalidError("the Authorization header holds no key of this library")
            raise KeyRequiredError("this call needs an API key")
        elif needed == "write" and caller.key.scope == "read":
            raise ScopeError("this key may only read")

    async def _caller(self, scope: Scope, headers: Headers) -> Caller:
        service = cast("Service", scope["app"].state.service)
        token = _token(headers.get("authorization"))
        key, closed = await service.library.store.fetch(partial(_look_up, token=token), ("key", token))
        client, _ = scope.get("client") or ("", None)
        if key and key.is_expired:
            key = None
        return Caller(key, closed or not (self._settings.open or _is_local(scope, headers)), client)

    def _check_host(self, scope: Scope, headers: Headers) -> None:
        """Refuse a call by an unknown name: a site can have its own name lead here, and read what its pages ask.

        A page at an address, or at localhost, is not another site's. With a key this is not needed: no page has it.
        """
        host = _PORT.sub("", headers.get("host", "")).strip("[]").lower()
        known = not host or is_loopback(host) or is_address(host) or _is_within(scope)
        if not (known or {host, "*"} & set(self._settings.hosts)):
            raise HostError(f"the service does not know itself as {host[:100]!r}")

    def _check_origin(self, headers: Headers) -> None:
        """Refuse what a page of another site has the browser of somebody here send: CORS only hides the answer."""
        origin = headers.get("origin")
        if origin is None or {origin, "*"} & set(self._settings.origins):
            return
        if origin.partition("://")[2] != headers.get("host"):
            raise OriginError("a page of another site may not write here")


def _is_local(scope: Scope, headers: Headers) -> bool:
    """Whether a call came from this machine to this machine, by a name of this machine.

    A proxy on this machine tells of another client, and a page whose site's name was made to lead here another host.
    """
    if any(name in headers for name in _FORWARDED):
        return False
    if _is_within(scope):
        return True
    (here, _), (client, _) = scope.get("server") or ("", None), scope.get("client") or ("", None)
    return all(map(is_loopback, (here, client, _PORT.sub("", headers.get("host", "")).strip("[]"))))


def _is_within(scope: Scope) -> bool:
    """Whether a call was made within the process: a server that has a name for an address listens nowhere."""
    here, _ = scope.get("server") or ("", None)
    return bool(here) and "/" not in here and not is_address(here)


def _token(given: str | None) -> str | None:
    scheme, _, token = (given or "").partition(" ")
    return token.strip() if scheme.lower() == "bearer" else None


def _look_up(connection: Connection, token: str | None) -> tuple[KeyRecord | None, bool]:
    key = find_key(connection, token) if token else None
    return key, key is not None or has_keys(connection)
