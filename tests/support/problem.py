"""The format of all errors over HTTP."""

from __future__ import annotations

import httpx

MEMBERS = {"type", "title", "status", "detail", "code", "advice", "errors"}

TITLES = {
    400: "Bad Request", 401: "Unauthorized", 403: "Forbidden", 404: "Not Found", 405: "Method Not Allowed",
    406: "Not Acceptable", 408: "Request Timeout", 409: "Conflict", 412: "Precondition Failed",
    413: "Content Too Large",
    415: "Unsupported Media Type", 416: "Range Not Satisfiable", 422: "Unprocessable Content", 429: "Too Many Requests",
    431: "Request Header Fields Too Large", 500: "Internal Server Error", 501: "Not Implemented",
    503: "Service Unavailable", 504: "Gateway Timeout", 505: "HTTP Version Not Supported",
    507: "Insufficient Storage",
}  # fmt: skip


def check(response: httpx.Response, status: int, code: str) -> dict:
    """Check the format of a problem response; return the problem."""
    assert response.status_code == status, response.text
    assert response.headers["content-type"] == "application/problem+json"
    problem = response.json()
    assert set(problem) == MEMBERS
    assert problem["status"] == status
    assert problem["code"] == code
    assert problem["type"] == "about:blank"
    assert problem["title"] == TITLES[status]
    assert response.headers["x-request-id"]
    assert problem["detail"]
    for item in problem["errors"]:
        assert set(item) == {"field", "message"}
    assert "Traceback" not in response.text
    return problem
