"""Readers do not wait for blocked writers, and the history of jobs is bounded."""

from __future__ import annotations

import json
import sqlite3
import threading
import time
from contextlib import closing

import httpx
import pytest

from tests.support.problem import check
from tests.support.server import SAMPLES, Server, ended, post_mesh, small_mesh, stored

FEW = json.dumps(SAMPLES)


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    with Server(tmp_path_factory.mktemp("writers"), workers=1) as running:
        yield running


@pytest.fixture
def http(server):
    with server.http() as client:
        yield client


def test_readers_do_not_wait_for_writers(server, http):
    shape = stored(http, small_mesh(1), parameters=FEW)["id"]
    answers: list[int] = []

    def change(number: int) -> None:
        answers.append(
            httpx.patch(f"{server.url}/v1/shapes/{shape}", json={"name": f"n{number}"}, timeout=90).status_code
        )

    threads = [threading.Thread(target=change, args=(number,)) for number in range(60)]
    with closing(sqlite3.connect(server.library, isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")  # another process holds the write lock for a while
        for thread in threads:
            thread.start()
        time.sleep(1.0)
        begun = time.monotonic()
        for path in ("", f"/{shape}", f"/{shape}/mesh", f"/{shape}/descriptors", f"/{shape}/signature"):
            assert http.get(f"/v1/shapes{path}").status_code == 200
        assert http.get("/v1/classes").status_code == 200
        assert http.get("/v1/jobs").status_code == 200
        assert http.post("/v1/queries", json={"shape_id": shape}).status_code == 200
        took = time.monotonic() - begun
        assert not answers
        other.execute("ROLLBACK")
    for thread in threads:
        thread.join()
    assert answers == [200] * 60
    assert took < 10.0


def test_lists_of_jobs_are_paginated_and_have_no_results(http):
    shape = stored(http, small_mesh(2), parameters=FEW)
    form = {"files": {"file": ("m.ply", small_mesh(3))}, "data": {"parameters": FEW}}
    jobs = [ended(http, http.post("/v1/queries", **form))["id"] for _ in range(3)]
    assert http.get(f"/v1/jobs/{jobs[0]}").json()["result"]["shapes"]
    page = http.get("/v1/jobs", params={"limit": 2, "kind": "query"}).json()
    assert [item["id"] for item in page["items"]] == [jobs[2], jobs[1]]
    assert all("result" not in item for item in page["items"])
    rest = http.get("/v1/jobs", params={"limit": 2, "kind": "query", "cursor": page["next_cursor"]}).json()
    assert rest["items"][0]["id"] == jobs[0]
    (upload,) = http.get("/v1/jobs", params={"shape_id": shape["id"]}).json()["items"]
    assert upload["kind"] == "shape"


def test_old_jobs_are_deleted_on_request_and_beyond_the_limit(tmp_path):
    with Server(tmp_path, workers=1, job_history=4) as server, server.http() as http:
        jobs = [ended(http, post_mesh(http, small_mesh(number), parameters=FEW)) for number in range(3)]
        check(http.delete("/v1/jobs"), 422, "request_invalid")
        check(http.delete("/v1/jobs", params={"before": "2026-01-01T00:00:00"}), 422, "request_invalid")
        assert http.delete("/v1/jobs", params={"before": "2020-01-01T00:00:00Z"}).json() == {"forgotten": 0}
        before = jobs[1]["finished_at"]
        assert http.delete("/v1/jobs", params={"before": before}).json() == {"forgotten": 1}
        check(http.get(f"/v1/jobs/{jobs[0]['id']}"), 404, "not_found")
        assert http.get(f"/v1/shapes/{jobs[0]['shape_id']}").status_code == 200
        for number in range(3, 8):
            ended(http, post_mesh(http, small_mesh(number), parameters=FEW))
    with Server(tmp_path, workers=1, ready=False, job_history=4) as server, server.http() as http:
        end = time.monotonic() + 30.0
        while len(http.get("/v1/jobs").json()["items"]) > 4:
            assert time.monotonic() < end
            time.sleep(0.1)
        assert len(http.get("/v1/shapes").json()["items"]) == 8
