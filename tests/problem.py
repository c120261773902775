"""The one shape of all errors over HTTP."""

from __future__ import annotations

import httpx

MEMBERS = {"type", "title", "status", "detail", "code", "advice", "errors"}


def check(response: httpx.Response, status: int, code: str) -> dict:
    """The problem that a response is, after looking at its shape."""
    assert response.status_code == status, response.text
    assert response.headers["content-type"] == "application/problem+json"
    problem = response.json()
    assert set(problem) == MEMBERS
    assert problem["status"] == status
    assert problem["code"] == code
    assert problem["type"] == "about:blank"
    assert problem["title"]
    assert problem["detail"]
    for item in problem["errors"]:
        assert set(item) == {"field", "message"}
    assert "Traceback" not in response.text
    return problem
