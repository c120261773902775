"""Internal errors are problem documents that reveal nothing internal."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from tests.support.problem import check
from tests.support.server import Server, post_mesh, small_mesh
from unbend import UnbendError
from unbend.api.schema.problems import MEDIA_TYPE, status_of

STATUSES = {
    "access": 403, "address": 500, "backup": 503, "busy": 503, "call_timeout": 504, "error": 500, "exists": 422,
    "exposed": 403, "extra_missing": 500, "host_refused": 403, "idempotency_mismatch": 409,
    "job_cancelled": 409, "job_failed": 500, "job_memory": 507, "job_timeout": 504, "key_invalid": 401,
    "key_required": 401, "mesh_file": 422, "mesh_format": 415, "mesh_geometry": 422, "mesh_invalid": 422,
    "mesh_missing": 422, "mesh_read": 422, "mesh_too_large": 422, "move": 503, "not_found": 404,
    "object_damaged": 500, "object_missing": 503, "objects_unavailable": 503, "origin_refused": 403,
    "parameter_invalid": 422, "precondition_failed": 412, "queue_full": 429, "quota_exceeded": 429,
    "rate_limited": 429, "results": 500, "scope_insufficient": 403, "service": 500, "store": 503, "store_full": 507,
    "store_in_use": 503, "store_lost": 503, "store_outdated": 503, "store_unavailable": 503, "store_unfinished": 503,
    "store_version": 503, "temporary_full": 507, "unsuited": 409, "upload_too_large": 413,
    "upload_too_slow": 408, "vectors_missing": 503, "worker_lost": 500,
}  # fmt: skip
"""The HTTP status of every error of the package, by its code: clients depend on both."""


def every_error(kind: type[UnbendError] = UnbendError) -> Iterator[type[UnbendError]]:
    yield kind
    for child in kind.__subclasses__():
        yield from every_error(child)


def test_every_error_has_its_http_status():
    assert {kind.code: status_of(kind("what happened")) for kind in every_error()} == STATUSES


@pytest.fixture
def own_server(tmp_path: Path) -> Iterator[Server]:
    with Server(tmp_path, workers=1, ready=False) as running:
        yield running


def broken(server: Server, statement: str) -> None:
    with closing(sqlite3.connect(server.library, isolation_level=None)) as connection:
        connection.execute("PRAGMA foreign_keys = OFF")
        connection.execute(statement)


CALLS = [
    ("GET", "/v1/shapes"), ("GET", "/v1/shapes/x"), ("PATCH", "/v1/shapes/x"), ("GET", "/v1/classes"),
    ("GET", "/v1/map"), ("GET", "/v1/evaluation"), ("GET", "/v1/shapes/x/mesh"),
    ("GET", "/v1/shapes/x/geodesics?source=0"),
    ("POST", "/v1/queries"),
]  # fmt: skip


def test_a_damaged_store_is_reported_without_internal_details(own_server):
    broken(own_server, "DROP TABLE shapes")
    with own_server.http() as http:
        for method, path in CALLS:
            body = {"POST": {"shape_id": "x"}, "PATCH": {"name": "x"}}.get(method)
            response = http.request(method, path, json=body)
            problem = check(response, 503, "store")
            check_nothing_internal(own_server, response.text)
            assert problem["detail"] == "the library's store cannot be used"
            assert response.headers["x-request-id"] in own_server.log.read_text()
        check(post_mesh(http, small_mesh(0)), 503, "store")
        assert http.get("/v1/livez").status_code == 200
    assert "no such table: shapes" in own_server.log.read_text()  # the log has the cause


def test_requests_are_refused_when_keys_cannot_be_looked_up(own_server):
    broken(own_server, "DROP TABLE api_keys")
    with own_server.http() as http:
        for method, path in CALLS:
            response = http.request(method, path, headers={"Authorization": "Bearer unbend_x"})
            check(response, 503, "store")
            check_nothing_internal(own_server, response.text)


def test_an_unexpected_error_reveals_only_the_request_id(own_server):
    # An invalid time in a sound store stands for an error that the code does not expect.
    with own_server.http() as http:
        job = post_mesh(http, small_mesh(0)).json()
        broken(own_server, f"UPDATE jobs SET created_at = 'never' WHERE id = '{job['id']}'")  # noqa: S608
        response = http.get(f"/v1/jobs/{job['id']}", headers={"X-Request-ID": "the-one"})
    problem = check(response, 500, "error")
    assert problem == {
        "type": "about:blank", "title": "Internal Server Error", "status": 500, "code": "error", "advice": "",
        "detail": "The service failed; its log has the cause.", "errors": [],
    }  # fmt: skip
    assert response.headers["content-type"] == MEDIA_TYPE
    assert response.headers["x-request-id"] == "the-one"
    check_nothing_internal(own_server, response.text)
    assert "Traceback" in own_server.log.read_text()


def check_nothing_internal(server: Server, text: str) -> None:
    for word in ("SELECT", "sqlite", "sqlalchemy", "Traceback", ".py", "table", "never", str(server.library)):
        assert word not in text, word
