"""Results computed during a request: small ones do not wait for large ones, and clients can request a job instead."""

from __future__ import annotations

import json
import threading
import time

import httpx
import pytest

from tests.support.problem import check
from tests.support.server import SAMPLES, Server, ended, ply, small_mesh, stored
from unbend.mesh.shapes import torus

FEW = json.dumps(SAMPLES)
ASYNC = {"Prefer": "respond-async"}


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    with Server(tmp_path_factory.mktemp("lanes"), workers=1, call_seconds=40) as running:
        yield running


@pytest.fixture(scope="module")
def http(server):
    with server.http() as client:
        yield client


@pytest.fixture(scope="module")
def small(http) -> str:
    return stored(http, small_mesh(1), parameters=FEW)["id"]


@pytest.fixture(scope="module")
def large(http) -> str:
    return stored(http, ply(torus(columns=500, rows=300)), parameters=FEW)["id"]


def test_a_small_download_does_not_wait_for_large_computations(server, http, small, large):
    http.get(f"/v1/shapes/{small}/mesh?format=obj").raise_for_status()  # starts the process for small downloads
    answers: list[int] = []

    def measure(source: int) -> None:
        address = f"{server.url}/v1/shapes/{large}/geodesics?source={source}"
        answers.append(httpx.get(address, timeout=120).status_code)

    threads = [threading.Thread(target=measure, args=(source,)) for source in range(6)]
    for thread in threads:
        thread.start()
    time.sleep(0.5)
    begun = time.monotonic()
    assert http.get(f"/v1/shapes/{small}/mesh?format=off").status_code == 200
    took = time.monotonic() - begun
    waiting = 6 - len(answers)
    for thread in threads:
        thread.join()
    assert waiting > 0
    assert took < 5.0
    assert set(answers) <= {200, 504}


def documented_types(http):
    """Return the media types of a job's file in the OpenAPI document."""
    return http.get("/openapi.json").json()["paths"]["/v1/jobs/{job_id}/file"]["get"]["responses"]["200"]["content"]


CALLS = [
    "mesh?format=obj", "signature?whole=true&format=ply", "signature?whole=true", "flattening?format=glb",
    "geodesics?source=3&target=9",
]  # fmt: skip


@pytest.mark.parametrize("call", CALLS)
def test_a_result_computed_as_a_job_equals_the_direct_answer(http, small, call):
    address = f"/v1/shapes/{small}/{call}"
    accepted = http.get(address, headers=ASYNC)
    assert accepted.headers["preference-applied"] == "respond-async"
    job = ended(http, accepted)
    assert (job["kind"], job["state"], job["shape_id"]) == ("file", "succeeded", small)
    made, there = http.get(f"/v1/jobs/{job['id']}/file"), http.get(address)
    assert made.headers["content-type"] == there.headers["content-type"]
    assert made.headers["content-type"] in documented_types(http)
    if call.startswith("geodesics"):
        assert made.json() == there.json()
    else:
        assert made.content == there.content
        assert made.headers["content-disposition"] == there.headers["content-disposition"]


def test_a_job_fails_with_the_same_error_as_the_direct_request(http, small):
    address = f"/v1/shapes/{small}/geodesics?source=1000"
    problem = check(http.get(address), 409, "unsuited")
    job = ended(http, http.get(address, headers=ASYNC))
    assert (job["state"], job["error"]["code"], job["error"]["message"]) == ("failed", "unsuited", problem["detail"])
    check(http.get(f"/v1/jobs/{job['id']}/file"), 404, "not_found")


def test_the_file_of_a_job_is_removed_with_its_shape(http):
    shape = stored(http, small_mesh(2), parameters=FEW)["id"]
    job = ended(http, http.get(f"/v1/shapes/{shape}/mesh?format=off", headers=ASYNC))
    assert http.get(f"/v1/jobs/{job['id']}/file").status_code == 200
    http.delete(f"/v1/shapes/{shape}")
    check(http.get(f"/v1/jobs/{job['id']}/file"), 404, "not_found")
    check(http.get(f"/v1/shapes/{shape}/mesh?format=off", headers=ASYNC), 404, "not_found")


def test_a_request_that_takes_too_long_advises_to_request_a_job(tmp_path, large, http):
    data = http.get(f"/v1/shapes/{large}/mesh").content
    with Server(tmp_path, workers=1, call_seconds=0.05) as server, server.http() as hasty:
        shape = stored(hasty, data, parameters=FEW)["id"]
        problem = check(hasty.get(f"/v1/shapes/{shape}/geodesics?source=0"), 504, "call_timeout")
        assert "respond-async" in problem["advice"]
        job = ended(hasty, hasty.get(f"/v1/shapes/{shape}/geodesics?source=0", headers=ASYNC))
        assert job["state"] == "succeeded"
