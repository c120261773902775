"""Every error is a problem document, and limits are enforced before parsing."""

from __future__ import annotations

import asyncio
import http.client
import json
import re
import time
from collections.abc import Iterator
from types import SimpleNamespace
from typing import cast
from urllib.parse import urlsplit

import httpx
import pytest

from tests.support.problem import check
from tests.support.server import SAMPLES, post_mesh, slow_mesh, small_mesh, stored
from unbend.api.routes.health import readyz
from unbend.api.schema.problems import ProblemError
from unbend.api.server.service import Service

FEW = json.dumps(SAMPLES)


@pytest.fixture(scope="module")
def http_client(server):
    with server.http() as client:
        yield client


@pytest.mark.parametrize("path", ["/nothing", "/v1", "/v1/nothing", "/v1/shapes/a/b/c"])
def test_an_unknown_route_is_not_found(http_client, path):
    check(http_client.get(path), 404, "not_found")


@pytest.mark.parametrize(
    ("method", "path", "allowed"),
    [
        ("PUT", "/v1/shapes", "GET, POST, HEAD, OPTIONS"),
        ("TRACE", "/v1/shapes/x", "GET, PATCH, DELETE, HEAD, OPTIONS"),
        ("POST", "/v1/jobs/x", "GET, DELETE, HEAD, OPTIONS"),
        ("GET", "/v1/queries", "POST, OPTIONS"),
        ("HEAD", "/v1/queries", "POST, OPTIONS"),
        ("PUT", "/docs", "GET, HEAD, OPTIONS"),
        ("POST", "/docs-assets/favicon.png", "GET, HEAD, OPTIONS"),
    ],
)
def test_an_unsupported_method_is_refused_with_the_allowed_methods(http_client, method, path, allowed):
    response = http_client.request(method, path)
    if method == "HEAD":
        assert (response.status_code, response.content) == (405, b"")
    else:
        problem = check(response, 405, "method_not_allowed")
        assert method in problem["detail"]
        assert "Allow" in problem["advice"]
    assert response.headers["allow"] == allowed
    reported = http_client.options(path)
    assert (reported.status_code, reported.content, reported.headers["allow"]) == (204, b"", allowed)


def test_options_of_an_unknown_route_are_not_found(http_client):
    check(http_client.options("/v1/nothing"), 404, "not_found")


def test_head_answers_like_get_without_a_body(http_client):
    for path in ("/v1/classes", "/v1/readyz", "/docs"):
        got, head = http_client.get(path), http_client.head(path)
        assert (head.status_code, head.content) == (200, b"")
        for name in ("content-type", "content-length", "content-security-policy"):
            assert head.headers[name] == got.headers[name]
    assert http_client.head("/v1/shapes/nobody").status_code == 404


def test_a_trailing_slash_is_not_found(http_client):
    check(http_client.get("/v1/shapes/"), 404, "not_found")
    check(http_client.post("/v1/queries/"), 404, "not_found")


def test_an_unknown_shape_is_not_found_with_advice(http_client):
    problem = check(http_client.get("/v1/shapes/nobody"), 404, "not_found")
    assert problem["detail"] == "no shape nobody"
    assert problem["advice"]


def test_a_file_of_an_unsupported_format_is_refused(http_client):
    problem = check(post_mesh(http_client, b"\x89PNG\r\n", file_name="cat.png"), 415, "mesh_format")
    assert "off, obj, ply, stl, glb" in problem["detail"]
    check(post_mesh(http_client, b"", file_name="empty"), 415, "mesh_format")


def test_an_unsupported_response_format_is_not_acceptable(http_client):
    shape = stored(http_client, small_mesh(240), parameters=FEW)
    response = http_client.get(f"/v1/shapes/{shape['id']}/mesh", headers={"Accept": "text/html"})
    assert "Accept" in check(response, 406, "not_acceptable")["advice"]


@pytest.mark.parametrize(
    ("method", "path", "kind"),
    [("POST", "/v1/shapes", "multipart/form-data"), ("PATCH", "/v1/shapes/x", "application/json")],
)
@pytest.mark.parametrize("sent", ["text/plain", "application/x-www-form-urlencoded", "application/xml", None])
def test_a_body_of_the_wrong_media_type_is_unsupported(http_client, method, path, kind, sent):
    headers = {"Content-Type": sent} if sent else {}
    problem = check(
        http_client.request(method, path, content=b"name=x", headers=headers), 415, "unsupported_media_type"
    )
    assert kind in problem["detail"]
    assert kind in problem["advice"]


def test_invalid_fields_of_a_request_are_named(http_client):
    problem = check(http_client.get("/v1/shapes", params={"limit": 501}), 422, "request_invalid")
    assert [item["field"] for item in problem["errors"]] == ["query.limit"]
    problem = check(http_client.post("/v1/shapes", files={"name": (None, "x")}), 422, "request_invalid")
    assert [item["field"] for item in problem["errors"]] == ["body.file"]
    problem = check(post_mesh(http_client, small_mesh(241), label="x" * 201), 422, "request_invalid")
    assert [item["field"] for item in problem["errors"]] == ["body.label"]
    problem = check(http_client.get("/v1/jobs", params={"state": "lost", "limit": 0}), 422, "request_invalid")
    assert {item["field"] for item in problem["errors"]} == {"query.state", "query.limit"}


FILE_FORMS = ["/v1/shapes", "/v1/queries", "/v1/views"]


@pytest.mark.parametrize("path", FILE_FORMS)
def test_a_file_that_is_sent_as_text_is_refused_with_advice(http_client, path):
    problem = check(http_client.post(path, files={"file": (None, "justtext")}), 422, "request_invalid")
    assert problem["errors"] == [{"field": "body.file", "message": "this is text, not a file"}]
    assert "file=@" in problem["advice"]


@pytest.mark.parametrize("path", FILE_FORMS)
def test_a_file_in_an_unknown_field_is_named(http_client, path):
    problem = check(http_client.post(path, files={"mesh": ("cat.ply", small_mesh(241))}), 422, "request_invalid")
    assert {item["field"]: item["message"] for item in problem["errors"]} == {
        "body.file": "a file is required",
        "body.mesh": "there is no such field",
    }
    assert "file=@" in problem["advice"]
    assert "The fields are" in problem["advice"]


@pytest.mark.parametrize(
    ("method", "path", "body"),
    [
        ("PATCH", "/v1/shapes/x", {"labl": "cat"}),
        ("POST", "/v1/queries", {"shape_id": "x", "labl": "cat"}),
        ("POST", "/v1/matches", {"a": "x", "b": "y", "labl": "cat"}),
        ("GET", "/v1/shapes?labl=cat", None),
    ],
)
def test_an_unknown_field_has_one_message_everywhere(http_client, method, path, body):
    problem = check(http_client.request(method, path, json=body), 422, "request_invalid")
    assert [item["message"] for item in problem["errors"]] == ["there is no such field"]
    assert problem["advice"]


@pytest.mark.parametrize(
    "query", ["shapes?cursor=foo", "jobs?cursor=foo", "jobs?shape_id=foo", "shapes?sha256=foo", "jobs?state=foo"]
)
def test_messages_contain_no_patterns(http_client, query):
    problem = check(http_client.get(f"/v1/{query}"), 422, "request_invalid")
    assert not re.search(r"\^|\[|pattern|Value error", problem["detail"])
    assert "should" in problem["detail"]


def test_a_time_without_offset_is_refused_in_plain_words(http_client):
    problem = check(http_client.delete("/v1/jobs", params={"before": "2026"}), 422, "request_invalid")
    assert problem["detail"].startswith("query.before: should be an instant")


@pytest.mark.parametrize("size", [10, 100_000])
def test_a_mesh_without_a_form_is_refused_with_advice_to_send_a_form(http_client, size):
    headers = {"Content-Type": "application/x-www-form-urlencoded"}  # as `curl --data-binary` sends it
    response = http_client.post("/v1/shapes", content=bytes(size), headers=headers)
    status, code = (415, "unsupported_media_type") if size < 2**16 else (413, "upload_too_large")
    assert "multipart/form-data" in check(response, status, code)["advice"]


def test_a_vertex_that_the_file_does_not_have_is_refused_with_the_numbers_that_it_has(http_client):
    shape = stored(http_client, small_mesh(240), parameters=FEW)
    response = http_client.get(f"/v1/shapes/{shape['id']}/geodesics", params={"source": 99999})
    assert "0 to 59" in check(response, 409, "unsuited")["advice"]


def test_a_starting_server_says_that_jobs_wait():
    runner = SimpleNamespace(alive=True, ready=False)
    with pytest.raises(ProblemError) as caught:
        asyncio.run(readyz(cast("Service", SimpleNamespace(runner=runner))))
    problem = caught.value.problem
    assert problem.status == 503
    assert "compile" in problem.detail
    assert "jobs wait" in problem.detail
    assert problem.advice


def test_a_response_without_content_has_no_content_type(http_client):
    shape = stored(http_client, small_mesh(243), parameters=FEW)
    response = http_client.delete(f"/v1/shapes/{shape['id']}")
    assert (response.status_code, response.content) == (204, b"")
    assert "content-type" not in response.headers


@pytest.mark.parametrize(
    "parameters",
    ["{", "[]", "null", '{"samples": 3}', '{"samples": "many"}', '{"colour": 1}', '{"method": "x"}', "NaN"],
)
def test_invalid_parameters_are_refused(http_client, parameters):
    problem = check(post_mesh(http_client, small_mesh(242), parameters=parameters), 422, "parameter_invalid")
    assert problem["errors"] == [{"field": "body.parameters", "message": problem["detail"]}]


@pytest.mark.parametrize("path", ["/v1/shapes", "/v1/queries"])
@pytest.mark.parametrize(
    ("policy", "word"),
    [
        ("{", "policy"),
        ("[]", "policy"),
        ('{"component": "bridge"}', "policy: unknown field 'component'"),
        ('{"components": "all"}', "components"),
        ('{"max_vertices": 3}', "max_vertices"),
        ('{"max_vertices": "many"}', "max_vertices"),
    ],
)
def test_an_invalid_policy_is_refused_before_a_job_is_created(http_client, path, policy, word):
    before = http_client.get("/v1/jobs", params={"limit": 1}).json()
    response = http_client.post(path, files={"file": ("x.ply", small_mesh(242))}, data={"policy": policy})
    problem = check(response, 422, "parameter_invalid")
    assert word in problem["detail"]
    assert [item["field"] for item in problem["errors"]] == ["body.policy"]
    assert http_client.get("/v1/jobs", params={"limit": 1}).json() == before


@pytest.mark.parametrize("metadata", ["{", "[]", "null", "1", '"text"'])
def test_metadata_must_be_a_json_object(http_client, metadata):
    problem = check(post_mesh(http_client, small_mesh(242), metadata=metadata), 422, "parameter_invalid")
    assert "metadata" in problem["detail"]
    assert [item["field"] for item in problem["errors"]] == ["body.metadata"]


def test_deep_parameters_are_refused(http_client):
    check(post_mesh(http_client, small_mesh(242), parameters="[" * 60_000), 422, "parameter_invalid")


@pytest.mark.parametrize("cursor", ["x", "", "-1", "1" * 19, "\u0661"])
def test_an_invalid_cursor_is_refused(http_client, cursor):
    problem = check(http_client.get("/v1/shapes", params={"cursor": cursor}), 422, "request_invalid")
    assert [item["field"] for item in problem["errors"]] == ["query.cursor"]


@pytest.mark.parametrize("path", ["/v1/shapes", "/v1/queries"])
@pytest.mark.parametrize("boundary", ["; boundary=b", ""])
def test_a_malformed_form_is_a_bad_request(http_client, path, boundary):
    headers = {"Content-Type": f"multipart/form-data{boundary}"}
    check(http_client.post(path, content=b"this is no form", headers=headers), 400, "bad_request")


@pytest.mark.parametrize("path", ["/v1/shapes", "/v1/queries"])
def test_a_truncated_form_lacks_its_file(http_client, path):
    headers = {"Content-Type": "multipart/form-data; boundary=b"}
    cut = b'--b\r\nContent-Disposition: form-data; name="file"; filename="x.off"\r\n\r\nOFF 4 4'
    problem = check(http_client.post(path, content=cut, headers=headers), 422, "request_invalid")
    assert [item["field"] for item in problem["errors"]] == ["body.file"]


def test_malformed_json_is_refused(http_client):
    headers = {"Content-Type": "application/json"}
    check(http_client.patch("/v1/shapes/x", content=b"{", headers=headers), 422, "request_invalid")
    check(http_client.patch("/v1/shapes/x", content=b"\xff\xfe", headers=headers), 422, "request_invalid")
    check(http_client.post("/v1/queries", content=b"\xff\xfe", headers=headers), 422, "request_invalid")


@pytest.mark.parametrize("path", ["/v1/shapes", "/v1/queries"])
def test_an_oversized_upload_with_a_content_length_is_refused(small_server, path):
    with small_server.http() as client:
        response = client.post(path, files={"file": ("x.ply", bytes(3 * 2**20))})
        problem = check(response, 413, "upload_too_large")
        assert "1 megabytes" in problem["detail"]
        assert problem["advice"]


@pytest.mark.parametrize("path", ["/v1/shapes", "/v1/queries"])
def test_an_oversized_chunked_upload_is_refused_with_the_same_message(small_server, path):
    def body() -> Iterator[bytes]:
        yield b'--b\r\nContent-Disposition: form-data; name="file"; filename="x.ply"\r\n\r\n'
        for _ in range(48):
            yield bytes(2**16)

    with small_server.http() as client:
        announced = client.post(path, files={"file": ("x.ply", bytes(3 * 2**20))}).json()
        response = client.post(path, content=body(), headers={"Content-Type": "multipart/form-data; boundary=b"})
        assert check(response, 413, "upload_too_large") == announced


def test_oversized_json_is_refused(small_server):
    with small_server.http() as client:
        check(client.post("/v1/queries", json={"shape_id": "x" * 2**21}), 413, "upload_too_large")


def test_a_content_length_that_is_not_a_number_is_refused(small_server):
    address = urlsplit(small_server.url)
    connection = http.client.HTTPConnection(address.hostname, address.port, timeout=30)
    connection.putrequest("POST", "/v1/shapes")
    connection.putheader("Content-Length", "lots")
    connection.endheaders()
    assert connection.getresponse().status in {400, 411, 413}
    connection.close()


def test_a_full_queue_answers_429_with_a_retry_time(small_server):
    with small_server.http() as client:
        jobs = [
            post_mesh(client, slow_mesh(), parameters=json.dumps({"samples": 4000 + number})) for number in range(2)
        ]
        for response in jobs:
            assert response.status_code == 202
            until_running(client, response.headers["Location"])
        jobs.append(post_mesh(client, small_mesh(0), parameters=FEW))
        assert jobs[-1].json()["position"] == 0
        try:
            for refused in (
                post_mesh(client, small_mesh(1), parameters=FEW),
                client.post("/v1/queries", files={"file": ("x.ply", small_mesh(1))}),
            ):
                check(refused, 429, "queue_full")
                assert int(refused.headers["retry-after"]) >= 1
            assert client.get("/v1/capacity").json() == {
                "workers": 1, "running": 2, "queued": 1, "max_queued": 1, "search": "memory", "recall": None,
            }  # fmt: skip
        finally:
            for response in jobs:
                client.delete(response.headers["Location"])
        assert post_mesh(client, small_mesh(1), parameters=FEW).status_code == 202


def until_running(client: httpx.Client, url: str) -> None:
    end = time.monotonic() + 60
    while client.get(url).json()["state"] != "running":
        assert time.monotonic() < end
        time.sleep(0.02)
