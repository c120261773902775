"""Headers of responses: the security headers, and the documentation of other headers in OpenAPI."""

from __future__ import annotations

from typing import Final

from unbend.api.context import API_PREFIX

_ALWAYS: Final = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "X-Frame-Options": "DENY",
    "Content-Security-Policy": "default-src 'none'; frame-ancestors 'none'",
}
ETAG: Final = {"ETag": {"description": "Differs after each change.", "required": True, "schema": {"type": "string"}}}
LOCATION: Final = {
    "Location": {
        "description": "Path of the job.",
        "required": True,
        "schema": {"type": "string", "format": "uri-reference"},
    }
}
DISPOSITION: Final = {
    "Content-Disposition": {"description": "The file's name.", "required": True, "schema": {"type": "string"}},
    "Vary": {"description": "Accept chooses the format.", "required": True, "schema": {"type": "string"}},
}
"""OpenAPI documentation of headers: `ETAG` of records, `LOCATION` of jobs, and `DISPOSITION` of files."""


def headers_for(path: str) -> dict[str, str]:
    """Return the security headers of a response for `path`; those of the API are not cached by default."""
    return _ALWAYS | ({"Cache-Control": "no-store"} if path.startswith(f"{API_PREFIX}/") else {})
