"""Names that the parts of the HTTP API share: paths, headers, and the state of a request."""

from __future__ import annotations

from contextvars import ContextVar
from typing import Final, Literal

from starlette.types import Scope

API_PREFIX: Final = "/v1"

REQUEST_ID: Final = "X-Request-ID"
"""The header with the id of a request."""

CURRENT_REQUEST: Final[ContextVar[str | None]] = ContextVar("unbend request", default=None)
"""The id of the present request, for log lines. Each request runs in a task of its own, so no reset is needed."""

CALLER: Final = "unbend.caller"
"""Key of the caller in an ASGI scope: an API key's id, "open" if the service needs no key, or "none"."""

KEY: Final = "unbend.key"
"""Key of the caller's KeyRecord in an ASGI scope, if the service needs API keys."""

PROBES: Final = frozenset({f"{API_PREFIX}/livez", f"{API_PREFIX}/readyz", f"{API_PREFIX}/metrics"})

_PUBLIC: Final = frozenset({f"{API_PREFIX}/livez", f"{API_PREFIX}/readyz"})
_METHODS: Final = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"})
_STORING_NOTHING: Final = frozenset({f"{API_PREFIX}/queries", f"{API_PREFIX}/views"})
_READING: Final = frozenset({"GET", "HEAD", "OPTIONS"})


def is_guarded(path: str) -> bool:
    """Return whether a request for `path` needs a key, if the service needs keys."""
    return path.startswith(f"{API_PREFIX}/") and path not in _PUBLIC


def scope_of(method: str, path: str) -> Literal["read", "write"]:
    """Return the scope that a request needs. A query or a view of a file only reads, because it stores no shape."""
    return "read" if method in _READING or (method == "POST" and path in _STORING_NOTHING) else "write"


def method_of(scope: Scope) -> str:
    """Return the method of a request; "other" for unknown methods."""
    method: str = scope["method"]
    return method if method in _METHODS else "other"


def route_of(scope: Scope) -> str:
    """Return the path template of a request; "unmatched" if no route matches, because clients choose their paths."""
    template: str | None = getattr(scope.get("route"), "path", None)
    if template is None:
        return "unmatched"
    # In later versions of FastAPI, the routes of a router do not contain the prefix of its inclusion.
    has_no_prefix = scope["path"].startswith(f"{API_PREFIX}/") and not template.startswith(f"{API_PREFIX}/")
    return API_PREFIX + template if has_no_prefix else template


def job_path(job_id: str) -> str:
    """Return the path of a job."""
    return f"{API_PREFIX}/jobs/{job_id}"
