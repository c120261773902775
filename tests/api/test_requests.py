"""Request ids, and the log lines about requests."""

from __future__ import annotations

import asyncio
import json
import logging
import re
import time

import httpx
import pytest
from pydantic import ValidationError
from starlette.requests import Request
from starlette.routing import Route

from tests.support.server import DAMAGED, SAMPLES, Server, ended, post_mesh, small_mesh
from unbend.api import Settings, create_app
from unbend.api.server.metrics import Metrics

FEW = json.dumps(SAMPLES)
OWN = re.compile(r"[0-9a-f]{32}")


@pytest.fixture(scope="module")
def logging_server(tmp_path_factory):
    with Server(tmp_path_factory.mktemp("logs"), workers=1, log_format="json") as own:
        yield own


def lines(server: Server) -> list[dict]:
    """Return the log lines, which are JSON objects except for the greeting at the start."""
    return [json.loads(line) for line in server.log.read_text().splitlines() if not line.startswith("unbend: library")]


def until(server: Server, reached) -> list[dict]:
    end = time.monotonic() + 30
    while not reached(found := lines(server)):
        assert time.monotonic() < end, found
        time.sleep(0.05)
    return found


@pytest.mark.parametrize("given", ["a", "4f1c-99.x:y_Z", "00-4bf92f3577b34da6-01", "x" * 128])
def test_a_valid_request_id_is_returned(server, given):
    with server.http() as http:
        assert http.get("/v1/livez", headers={"X-Request-ID": given}).headers.get_list("x-request-id") == [given]


@pytest.mark.parametrize("given", [None, "", "x" * 129, "a b", 'a"b', "\u00e9".encode("latin-1"), "a\tb"])
def test_an_invalid_request_id_is_replaced_by_a_random_one(server, given):
    with server.http() as http:
        headers = {} if given is None else {"X-Request-ID": given}
        answers = [http.get("/v1/livez", headers=headers).headers["x-request-id"] for _ in range(2)]
    assert all(OWN.fullmatch(answer) for answer in answers)
    assert answers[0] != answers[1]


@pytest.mark.parametrize(("path", "status"), [("/nothing", 404), ("/v1/shapes?limit=0", 422)])
def test_errors_have_the_request_id(server, path, status):
    with server.http() as http:
        answer = http.get(path, headers={"X-Request-ID": "mine"})
    assert (answer.status_code, answer.headers["x-request-id"]) == (status, "mine")


def test_unexpected_errors_have_the_request_id(caplog):
    app = create_app()

    async def broken(_request: Request) -> None:
        raise ValueError("unexpected")

    app.router.routes.insert(0, Route("/broken", broken))

    async def ask() -> httpx.Response:
        transport = httpx.ASGITransport(app, raise_app_exceptions=False)
        async with httpx.AsyncClient(transport=transport, base_url="http://here") as http:
            return await http.get("/broken", headers={"X-Request-ID": "mine"})

    with caplog.at_level(logging.INFO, logger="unbend"):
        answer = asyncio.run(ask())
    assert (answer.status_code, answer.headers.get_list("x-request-id")) == (500, ["mine"])
    assert any(record.name == "unbend.requests" and " 500 " in record.getMessage() for record in caplog.records)


def test_the_log_links_a_request_to_its_job(logging_server):
    with logging_server.http() as http:
        accepted = http.post(
            "/v1/shapes",
            files={"file": ("mesh.ply", small_mesh(0))},
            data={"parameters": FEW},
            headers={"X-Request-ID": "the-upload"},
        )
        good = ended(http, accepted)
        bad = ended(http, post_mesh(http, DAMAGED, file_name="bad.off"))
    found = until(logging_server, lambda lines: any(line.get("job_id") == bad["id"] for line in lines))
    assert all({"time", "level", "logger", "message"} <= set(line) for line in found)
    reported = {line["logger"]: line for line in found if line.get("request_id") == "the-upload"}
    assert (reported["unbend.audit"]["key"], reported["unbend.audit"]["job_id"]) == ("open", good["id"])
    request = reported["unbend.requests"]
    assert (request["method"], request["route"], request["status"]) == ("POST", "/v1/shapes", 202)
    assert 0 < request["milliseconds"] < 60_000
    assert request["job_id"] == good["id"]
    messages = [line["message"] for line in found if line.get("job_id") == good["id"]]
    assert "shape job started, attempt 1" in messages
    assert "shape job succeeded" in messages
    failed = [line["message"] for line in found if line.get("job_id") == bad["id"]]
    assert any(re.match("shape job failed: mesh_read: .*ends early", message) for message in failed)
    assert not any(line.get("route") in {"/v1/readyz", "/v1/livez"} and line["status"] == 200 for line in found)


def test_a_request_cannot_forge_a_log_line(logging_server):
    with logging_server.http() as http:
        http.get("/v1/x%0a%7B%22forged%22:1%7D", headers={"X-Request-ID": 'a","forged":"'})
    assert not any("forged" in line for line in logging_server.log.read_text().splitlines())


def test_log_lines_in_text_format_contain_the_request_id(server):
    with server.http() as http:
        http.get("/v1/shapes", headers={"X-Request-ID": "a-line-of-text"})
    end = time.monotonic() + 30
    pattern = r"INFO unbend\.requests: GET /v1/shapes 200 \d+\.\d ms \[request_id=a-line-of-text\]"
    while not re.search(pattern, server.log.read_text()):
        assert time.monotonic() < end
        time.sleep(0.05)


def test_an_unknown_log_format_is_refused(monkeypatch):
    monkeypatch.setenv("UNBEND_LOG_FORMAT", "xml")
    with pytest.raises(ValidationError, match="log_format"):
        Settings()


def test_each_application_has_its_own_metrics():
    first, second = Metrics(), Metrics()
    first.answered("GET", "/", 200, 0.1)
    counted = {"method": "GET", "route": "/", "status": "200"}
    assert first.registry.get_sample_value("unbend_http_request_seconds_count", counted) == 1
    assert second.registry.get_sample_value("unbend_http_request_seconds_count", counted) is None
