"""Small requests that are expensive to handle: none of them delays other requests."""

from __future__ import annotations

import json
from collections.abc import Iterator

import httpx
import pytest

from tests.support.problem import check
from tests.support.server import SAMPLES, Server, small_mesh, stored
from tests.support.watchdog import watchdog

FEW = json.dumps(SAMPLES)
STALL = 0.25
"""Longest time, in seconds of the server's CPU, that one request may delay others."""


@pytest.fixture(scope="module")
def server(tmp_path_factory) -> Iterator[Server]:
    with Server(tmp_path_factory.mktemp("stalls"), workers=1) as running:
        yield running


@pytest.fixture(scope="module")
def shape(server) -> str:
    with server.http() as http:
        return stored(http, small_mesh(1), parameters=FEW)["id"]


def keys(count: int) -> bytes:
    return b"{" + b",".join(b'"k%d":1' % number for number in range(count)) + b"}"


NASTY = {
    "a megabyte of unknown keys": keys(100_000),
    "six megabytes of unknown keys": keys(600_000),
    "as many unknown keys as are taken": keys(5_500),
    "a deep list": b'{"metadata":' + b"[" * 30_000 + b"]" * 30_000 + b"}",
    "a long number": b'{"k":' + b"9" * 60_000 + b"}",
    "many members": b'{"metadata":{' + b",".join(b'"%d":1' % number for number in range(6_000)) + b"}}",
    "a long list": b'{"metadata":{"a":[' + b",".join([b"0"] * 30_000) + b"]}}",
    "no JSON": b"\xff" * 60_000,
    "one long string": b'{"name":"' + b"a" * 60_000 + b'"}',
    "escapes": b'{"name":"' + rb"\u0041" * 10_000 + b'"}',
}


@pytest.mark.parametrize("name", NASTY)
def test_an_expensive_json_body_is_refused_without_delaying_others(server, shape, name):
    json_type = {"Content-Type": "application/json"}
    with watchdog(server) as stalls, server.http() as http:
        for method, path in (("POST", "/v1/queries"), ("PATCH", f"/v1/shapes/{shape}")):
            response = http.request(method, path, content=NASTY[name], headers=json_type)
            assert response.status_code in {400, 413, 422}, response.text[:200]
            assert len(response.content) < 10_000
    assert stalls.failed == 0
    assert stalls.longest_computing < STALL


def test_a_json_body_is_limited_to_64_kilobytes(server, shape):
    json_type = {"Content-Type": "application/json"}
    with server.http() as http:
        for method, path in (("POST", "/v1/queries"), ("PATCH", f"/v1/shapes/{shape}")):
            problem = check(
                http.request(method, path, content=keys(100_000), headers=json_type), 413, "upload_too_large"
            )
            assert "64 kilobytes" in problem["detail"]


def test_a_problem_lists_ten_fields_and_counts_the_rest(server):
    with server.http() as http:
        problem = check(
            http.post("/v1/queries", json={f"k{number}": 1 for number in range(100)}), 422, "request_invalid"
        )
    assert len(problem["errors"]) == 10
    assert "and 91 more" in problem["detail"]  # the shape_id is missing too


FORMS = {
    "metadata of a megabyte": {"metadata": json.dumps({"a": "x" * 10**6})},
    "deep metadata": {"metadata": "[" * 400_000},
    "metadata of many keys": {"metadata": keys(60_000).decode()},
    "parameters of a megabyte": {"parameters": keys(90_000).decode()},
    "a policy of a megabyte": {"policy": keys(90_000).decode()},
    "a long name": {"name": "n" * 10**6},
}


@pytest.mark.parametrize("name", FORMS)
def test_an_expensive_form_is_refused_without_delaying_others(server, name):
    with watchdog(server) as stalls, server.http() as http:
        response = http.post("/v1/shapes", files={"file": ("mesh.ply", small_mesh(2))}, data=FORMS[name])
        assert response.status_code in {400, 413, 422}, response.text[:200]
        assert len(response.content) < 10_000
    assert stalls.longest_computing < STALL


ADDRESSES = [
    "/v1/shapes?" + "&".join(f"k{number}=1" for number in range(2000)),
    "/v1/shapes?cursor=" + "9" * 15_000,
    "/v1/shapes?label=" + "%F0%9F%98%80" * 1000,
    "/v1/map?parameters=" + "[" * 15_000,
    "/v1/evaluation?parameters=" + '{"samples":' + "9" * 10_000 + "}",
    "/v1/shapes/" + "a" * 15_000,
    "/v1/jobs?state=" + "x" * 15_000,
]


@pytest.mark.parametrize("number", range(len(ADDRESSES)))
def test_an_expensive_url_does_not_delay_others(server, number):
    with watchdog(server) as stalls, server.http() as http:
        response = http.get(ADDRESSES[number])
        assert response.status_code in {200, 404, 422, 431}, response.text[:200]
        assert len(response.content) < 20_000
    assert stalls.longest_computing < STALL


def test_every_operation_refuses_unknown_query_parameters(server, shape):
    document = httpx.get(f"{server.url}/openapi.json").json()
    with server.http() as http:
        for path, operations in document["paths"].items():
            for method in operations:
                if path.endswith(("livez", "readyz", "metrics", "capacity")) or method == "post":
                    continue
                address = path.replace("{shape_id}", shape).replace("{job_id}", shape)
                source = {"source": 0} if path.endswith("geodesics") else {}
                body = {"json": {"name": "n"}} if method == "patch" else {}
                response = http.request(method, address, params={"labell": "cat", **source}, **body)
                problem = check(response, 422, "request_invalid")
                assert problem["errors"][0]["field"] == "query.labell"
        assert http.get(f"/v1/shapes/{shape}").status_code == 200  # nothing was removed


def test_unknown_fields_of_an_upload_are_refused(server):
    with server.http() as http:
        response = http.post("/v1/shapes", files={"file": ("m.ply", small_mesh(3))}, data={"labl": "cat"})
        problem = check(response, 422, "request_invalid")
        assert problem["errors"][0]["field"] == "body.labl"
