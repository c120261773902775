"""Webhooks: delivery when a job ends, signatures, retries, and allowed addresses."""

from __future__ import annotations

import base64
import hashlib
import hmac
import json
import sqlite3
import threading
import time
from contextlib import closing
from http.server import BaseHTTPRequestHandler, HTTPServer

import pytest

from tests.support.problem import check
from tests.support.server import DAMAGED, SAMPLES, Server, ended, post_mesh, small_mesh
from unbend.api import Settings

FEW = json.dumps(SAMPLES)
SECRET = "a secret of the tests"  # noqa: S105
PATIENCE = 60.0
ON = {"webhook_hosts": "127.0.0.1, hooks.example", "webhook_secret": SECRET}


class Receiver:
    """A server that records the requests it gets, and answers with the given statuses, then with 200."""

    def __init__(self, *statuses: int) -> None:
        self.requests: list[tuple[dict[str, str], bytes]] = []
        self.statuses = list(statuses)
        receiver = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                body = self.rfile.read(int(self.headers["Content-Length"]))
                receiver.requests.append(({name.lower(): value for name, value in self.headers.items()}, body))
                self.send_response(receiver.statuses.pop(0) if receiver.statuses else 200)
                self.send_header("Location", "/elsewhere")
                self.send_header("Content-Length", "0")
                self.end_headers()

            def log_message(self, *_: object) -> None:
                pass

        self.server = HTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.server.server_port}/hook"
        self.thread = threading.Thread(target=self.server.serve_forever)
        self.thread.start()

    def close(self) -> None:
        self.server.shutdown()
        self.thread.join()
        self.server.server_close()

    def until(self, count: int) -> None:
        end = time.monotonic() + PATIENCE
        while len(self.requests) < count:
            assert time.monotonic() < end, self.requests
            time.sleep(0.05)


@pytest.fixture
def receiver(request):
    made = Receiver(*getattr(request, "param", ()))
    yield made
    made.close()


def test_each_job_is_delivered_once_with_a_valid_signature(tmp_path, receiver):
    with Server(tmp_path, workers=1, **ON) as server, server.http() as http:
        good = ended(http, post_mesh(http, small_mesh(1), parameters=FEW, callback=receiver.url))
        bad = ended(http, post_mesh(http, DAMAGED, file_name="m.off", callback=receiver.url))
        form = {"files": {"file": ("m.ply", small_mesh(2))}, "data": {"parameters": FEW, "callback": receiver.url}}
        query = ended(http, http.post("/v1/queries", **form))
        receiver.until(3)
        time.sleep(2.5)
    assert len(receiver.requests) == 3
    for job, (headers, body) in zip((good, bad, query), receiver.requests, strict=True):
        assert headers["webhook-id"] == job["id"]
        signed = f"{job['id']}.{headers['webhook-timestamp']}.".encode() + body
        digest = base64.b64encode(hmac.new(SECRET.encode(), signed, hashlib.sha256).digest()).decode()
        assert headers["webhook-signature"] == f"v1,{digest}"
        assert abs(int(headers["webhook-timestamp"]) - time.time()) < 120
        data = json.loads(body)["data"]
        assert (data["id"], data["kind"], data["state"]) == (job["id"], job["kind"], job["state"])
        assert data["shape_id"] == job["shape_id"]
        assert data["error"] == (job["error"]["code"] if job["error"] else None)


@pytest.mark.parametrize("receiver", [(500, 302)], indirect=True)
def test_a_failed_delivery_is_retried_and_redirects_are_not_followed(tmp_path, receiver):
    with Server(tmp_path, workers=1, **ON) as server, server.http() as http:
        ended(http, post_mesh(http, small_mesh(1), parameters=FEW, callback=receiver.url))
        receiver.until(3)
    assert len({headers["webhook-id"] for headers, _ in receiver.requests}) == 1
    assert "attempt 2: status 302" in server.log.read_text()


def test_the_next_server_delivers_pending_webhooks(tmp_path, receiver):
    with Server(tmp_path, workers=1, **ON) as server, server.http() as http:
        unreachable = receiver.url.replace(str(receiver.server.server_port), "9")
        job = ended(http, post_mesh(http, small_mesh(1), parameters=FEW, callback=unreachable))
        server.kill()
    receiver.close()
    again = Receiver()
    try:
        with closing(sqlite3.connect(server.library, isolation_level=None)) as connection:
            connection.execute("UPDATE jobs SET callback = ?, callback_due = 1", (again.url,))
        with Server(tmp_path, workers=1, ready=False, **ON):
            again.until(1)
        assert again.requests[0][0]["webhook-id"] == job["id"]
    finally:
        again.close()


REFUSED = [
    "https://other.example/", "http://hooks.example/", "ftp://hooks.example/", "https://hooks.example@other.example/",
    "https://user:password@hooks.example/", "https://hooks.example.other.example/", "hooks.example", "https://[",
    "http://127.0.0.1.other.example/", "file:///etc/passwd",
]  # fmt: skip


@pytest.fixture(scope="module")
def http(tmp_path_factory):
    with Server(tmp_path_factory.mktemp("hooks"), workers=1, ready=False, **ON) as server, server.http() as client:
        yield client


@pytest.mark.parametrize("address", REFUSED)
def test_addresses_that_are_not_allowed_are_refused_on_upload(http, address):
    response = post_mesh(http, small_mesh(1), parameters=FEW, callback=address)
    assert "callback" in check(response, 409, "unsuited")["detail"]


def test_webhooks_are_refused_by_default(tmp_path, receiver):
    with Server(tmp_path, workers=1, ready=False) as server, server.http() as api:
        response = post_mesh(api, small_mesh(1), parameters=FEW, callback=receiver.url)
        assert "UNBEND_WEBHOOK_HOSTS" in check(response, 409, "unsuited")["detail"]


def test_a_secret_that_is_no_base64_is_refused_at_the_start(monkeypatch):
    monkeypatch.setenv("UNBEND_WEBHOOK_HOSTS", "hooks.example")
    monkeypatch.setenv("UNBEND_WEBHOOK_SECRET", "whsec_" + "x" * 17)
    with pytest.raises(ValueError, match="base64 after whsec_"):
        Settings()


def test_a_server_with_webhooks_does_not_start_without_a_secret(tmp_path):
    with pytest.raises(RuntimeError, match="16 characters"):
        Server(tmp_path, workers=1, webhook_hosts="hooks.example", webhook_secret="short")  # noqa: S106
