"""Servers and a worker that share a library: whatever one does, the others see."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Callable

import httpx

from tests.support.server import (
    ENDLESS,
    SAMPLES,
    Server,
    Worker,
    ended,
    endless_mesh,
    is_running,
    post_mesh,
    small_mesh,
    stored,
)
from unbend import Library

ENDLESS_FIELDS = {"parameters": json.dumps(ENDLESS)}
FEW = {"parameters": json.dumps(SAMPLES)}
PATIENCE = 120.0


def until(reached: Callable[[], object]) -> None:
    deadline = time.monotonic() + PATIENCE
    while not reached():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def job_of(response: httpx.Response) -> str:
    assert response.status_code == httpx.codes.ACCEPTED, response.text
    return response.headers["Location"]


def computing(http: httpx.Client, place: str) -> bool:
    """Return whether a job has reported progress to the server of `http`."""
    job = http.get(place).json()
    assert job["state"] in {"queued", "running"}, job
    return job["stage"] in {"sampling", "geodesics", "embedding"}


def test_a_job_sent_to_one_server_is_waited_for_at_the_other(cluster):
    sent = post_mesh(cluster.first, small_mesh(1), name="one", **FEW)
    begun = time.monotonic()
    job = cluster.second.get(job_of(sent), params={"wait": 60}).json()
    assert job["state"] == "succeeded"
    assert time.monotonic() - begun < 55  # not the whole wait
    assert cluster.second.get(f"/v1/shapes/{job['shape_id']}").json()["name"] == "one"


def test_the_other_server_streams_the_progress_of_a_job(cluster):
    place = job_of(post_mesh(cluster.first, endless_mesh(), **ENDLESS_FIELDS))
    stages = []
    with cluster.second.stream("GET", f"{place}/events") as response:
        for line in response.iter_lines():
            if line.startswith("data:"):
                stages.append(json.loads(line.removeprefix("data:"))["stage"])
            if "geodesics" in stages:
                break
    assert {"sampling", "geodesics"} <= set(stages)
    cluster.first.delete(place)


def test_a_job_cancelled_at_any_server_loses_its_process_within_a_second(cluster):
    place = job_of(post_mesh(cluster.first, endless_mesh(), **ENDLESS_FIELDS))
    until(lambda: computing(cluster.second, place))
    before = cluster.worker.workers()
    begun = time.monotonic()
    assert cluster.second.delete(place).json()["state"] == "cancelled"
    until(lambda: not all(map(is_running, before)))
    assert time.monotonic() - begun < 1.0
    assert cluster.first.get(place).json()["state"] == "cancelled"
    assert stored(cluster.first, small_mesh(2), **FEW)["id"]  # the worker goes on


def test_every_server_knows_the_capacity_of_all_workers(cluster):
    for http in (cluster.first, cluster.second):
        until(lambda http=http: http.get("/v1/capacity").json()["workers"] == 2)


def test_a_request_repeated_at_the_other_server_gets_the_same_job(cluster):
    headers = {"Idempotency-Key": "the-same-upload"}
    sent = [
        each.post("/v1/shapes", files={"file": ("a.ply", small_mesh(3))}, data=FEW, headers=headers)
        for each in (cluster.first, cluster.second)
    ]
    assert job_of(sent[0]) == job_of(sent[1])


def test_a_change_at_one_server_is_in_the_next_answer_of_the_other(cluster):
    shapes = [stored(cluster.first, small_mesh(10 + number), label="before", **FEW) for number in range(3)]
    query = {"shape_id": shapes[0]["id"], "k": 1}
    found = cluster.second.post("/v1/queries", json=query).json()
    assert found["classes"][0]["label"] == "before"
    nearest = found["shapes"][0]["id"]
    assert cluster.first.patch(f"/v1/shapes/{nearest}", json={"label": "after"}).is_success
    found = cluster.second.post("/v1/queries", json=query).json()
    assert found["shapes"][0] | {"distance": 0} == {
        **found["shapes"][0],
        "id": nearest,
        "label": "after",
        "distance": 0,
    }
    assert cluster.first.delete(f"/v1/shapes/{nearest}").is_success
    assert cluster.second.post("/v1/queries", json=query).json()["shapes"][0]["id"] != nearest


def test_the_limits_of_a_key_hold_for_all_servers_together_until_it_is_revoked(cluster):
    with Library(cluster.library) as library:
        keeper, _ = library.keys.create("keeps the library closed", "read")
        key, text = library.keys.create("a key", "write", most_jobs=2)
        headers = {"Authorization": f"Bearer {text}"}
        places = []
        for number, http in enumerate((cluster.first, cluster.second, cluster.first, cluster.second)):
            response = http.post(
                "/v1/shapes",
                files={"file": ("a.ply", endless_mesh() + b"\n" * number)},
                data=ENDLESS_FIELDS,
                headers=headers,
            )
            if number < 2:
                places.append(job_of(response))
            else:
                assert response.status_code == httpx.codes.TOO_MANY_REQUESTS
        for place in places:
            assert cluster.second.delete(place, headers=headers).is_success
        assert cluster.first.get("/v1/shapes", headers=headers).is_success
        library.keys.revoke(key.id)
        for http in (cluster.first, cluster.second):
            assert http.get("/v1/shapes", headers=headers).status_code == httpx.codes.UNAUTHORIZED
        library.keys.revoke(keeper.id)


def test_a_worker_that_stops_returns_its_job_without_an_attempt(cluster, tmp_path):
    place = job_of(post_mesh(cluster.first, endless_mesh() + b"\n" * 9, **ENDLESS_FIELDS))
    until(lambda: computing(cluster.first, place))
    worker = Worker(tmp_path, library=cluster.library, workers=1, drain_seconds=0.5)
    with worker:
        cluster.worker.process.send_signal(signal.SIGSTOP)  # so that the other worker takes the next job
        other = job_of(post_mesh(cluster.second, endless_mesh() + b"\n" * 8, **ENDLESS_FIELDS))
        until(lambda: computing(cluster.second, other))
        cluster.worker.process.send_signal(signal.SIGCONT)
    job = cluster.first.get(other).json()
    assert job["attempts"] <= 1  # 0 if it waits, 1 if the first worker runs it already
    for each in (place, other):
        cluster.first.delete(each)


def test_the_job_of_a_killed_worker_runs_again_elsewhere(cluster, tmp_path):
    with Worker(tmp_path, library=cluster.library, workers=1, drain_seconds=0.5) as worker:
        os.kill(cluster.worker.process.pid, signal.SIGSTOP)
        place = job_of(post_mesh(cluster.first, endless_mesh() + b"\n" * 7, **ENDLESS_FIELDS))
        until(lambda: computing(cluster.second, place))
        os.kill(cluster.worker.process.pid, signal.SIGCONT)
        worker.kill()
        begun = time.monotonic()
        until(lambda: cluster.first.get(place).json()["attempts"] == 2)
        until(lambda: computing(cluster.first, place))
        assert time.monotonic() - begun < 45
    assert cluster.second.delete(place).json()["state"] == "cancelled"
    assert ended(cluster.first, post_mesh(cluster.second, small_mesh(4), **FEW))["attempts"] == 1


def test_servers_answer_503_while_the_database_is_down_and_then_go_on(cluster, postgres):
    shape = stored(cluster.first, small_mesh(5), **FEW)
    postgres.stop()
    try:
        for http in (cluster.first, cluster.second):
            response = http.get(f"/v1/shapes/{shape['id']}")
            assert response.status_code == httpx.codes.SERVICE_UNAVAILABLE
            assert response.json()["code"] == "store_unavailable"
            assert int(response.headers["Retry-After"]) >= 1
        assert cluster.first.get("/v1/livez").is_success
    finally:
        postgres.start()
    assert cluster.first.get(f"/v1/shapes/{shape['id']}").json() == shape
    assert stored(cluster.second, small_mesh(6), **FEW)["id"]


OLDER = """\
import unbend.signature.signature as module

module.ALGORITHM_VERSION = "older"
"""
"""Makes each process that starts with it one of an earlier version, as a `sitecustomize` on Python's path."""


def test_versions_may_be_mixed_and_each_signature_has_the_version_that_computed_it(
    tmp_path, monkeypatch, postgres, empty_postgres_library
):
    library = postgres.copy(empty_postgres_library)
    (tmp_path / "path").mkdir()
    (tmp_path / "path" / "sitecustomize.py").write_text(OLDER)
    with Server(tmp_path / "server", library=library, workers=0) as server, server.http() as http:
        monkeypatch.setenv("PYTHONPATH", f"{tmp_path / 'path'}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
        with Worker(tmp_path / "old", library=library, workers=1, drain_seconds=0.5):
            first = stored(http, small_mesh(1), **FEW)
        monkeypatch.undo()
        with Worker(tmp_path / "new", library=library, workers=1, drain_seconds=0.5):
            again = stored(http, small_mesh(1), **FEW)
            other = stored(http, small_mesh(2), **FEW)
        assert [each["version"] == "older" for each in (first, again, other)] == [True, False, False]
        found = http.post("/v1/queries", json={"shape_id": other["id"]}).json()
        assert [shape["id"] for shape in found["shapes"]] == [again["id"]]  # those of the other version do not compare
    postgres.drop(library)
