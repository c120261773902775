"""Repeated uploads of a file, repeated requests with an idempotency key, and limits of API keys."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta

import pytest

from tests.support.problem import check
from tests.support.server import (
    DAMAGED,
    ENDLESS,
    SAMPLES,
    Server,
    ended,
    endless_mesh,
    medium_mesh,
    post_mesh,
    small_mesh,
    stored,
)
from unbend import Library

FEW = json.dumps(SAMPLES)
LONG = json.dumps(ENDLESS)


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    with Server(tmp_path_factory.mktemp("uploads"), workers=1) as running:
        yield running


@pytest.fixture
def http(server):
    with server.http() as client:
        yield client


def test_a_repeated_upload_lists_the_fields_it_ignored(http):
    first = ended(http, post_mesh(http, small_mesh(1), parameters=FEW, name="first", label="cat"))
    again = post_mesh(http, small_mesh(1), parameters=FEW, name="second", label="dog", metadata='{"a": 1}')
    assert again.status_code == 200
    reported = again.json()
    assert (reported["id"], reported["name"], reported["label"]) == (first["shape_id"], "first", "cat")
    assert reported["ignored"] == ["label", "metadata", "name"]
    same = post_mesh(http, small_mesh(1), parameters=FEW, label="cat", file_name="other.ply").json()
    assert same["ignored"] == []


def test_a_repeated_upload_updates_the_shape_on_request(http):
    first = ended(http, post_mesh(http, small_mesh(2), parameters=FEW, name="first", label="cat"))
    reported = post_mesh(http, small_mesh(2), parameters=FEW, label="dog", if_known="update").json()
    assert (reported["id"], reported["name"], reported["label"], reported["ignored"]) == (
        first["shape_id"],
        "first",
        "dog",
        [],
    )
    assert http.get(f"/v1/shapes/{first['shape_id']}").json()["label"] == "dog"
    check(post_mesh(http, small_mesh(2), parameters=FEW, if_known="perhaps"), 422, "request_invalid")


def test_simultaneous_uploads_of_one_file_have_separate_jobs(http):
    mine = post_mesh(http, medium_mesh(), name="mine", label="a")
    theirs = post_mesh(http, medium_mesh(), name="theirs", label="b")
    changed = post_mesh(http, medium_mesh(), label="c", if_known="update")
    assert len({answer.json()["id"] for answer in (mine, theirs, changed)}) == 3
    assert http.delete(mine.headers["Location"]).json()["state"] == "cancelled"
    second, third = ended(http, theirs), ended(http, changed)
    assert (second["state"], second["ignored"]) == ("succeeded", [])
    assert (third["shape_id"], third["ignored"]) == (second["shape_id"], [])
    shape = http.get(f"/v1/shapes/{second['shape_id']}").json()
    assert (shape["name"], shape["label"]) == ("theirs", "c")


def test_the_second_of_two_simultaneous_jobs_lists_the_fields_it_ignored(http):
    answers = [post_mesh(http, small_mesh(3), parameters=FEW, label=label) for label in "ab"]
    jobs = [answer.json() if answer.status_code == 200 else ended(http, answer) for answer in answers]
    assert jobs[1]["ignored"] == ["label"]


def test_a_request_repeated_with_its_idempotency_key_runs_once(tmp_path):
    form = {"files": {"file": ("m.off", DAMAGED)}}
    names = {"Idempotency-Key": "3f1c-the-first"}
    with Server(tmp_path, workers=1) as server, server.http() as http:
        first = http.post("/v1/shapes", **form, headers=names)
        again = http.post("/v1/shapes", **form, headers=names)
        assert (first.status_code, again.status_code) == (202, 202)
        assert first.json()["id"] == again.json()["id"]
        other = {"files": {"file": ("m.ply", small_mesh(1))}}
        check(http.post("/v1/shapes", **other, headers=names), 409, "idempotency_mismatch")
        check(http.post("/v1/queries", **form, headers=names), 409, "idempotency_mismatch")
        for wrong in ("", "x" * 256, "a b"):
            response = http.post("/v1/shapes", **form, headers={"Idempotency-Key": wrong})
            assert response.status_code == 422
        ended(http, first)
    with Server(tmp_path, workers=1, ready=False) as server, server.http() as http:
        assert http.post("/v1/shapes", **form, headers=names).json()["id"] == first.json()["id"]
        assert len(http.get("/v1/jobs").json()["items"]) == 1


def test_an_upload_that_is_stored_already_keeps_no_idempotency_key(tmp_path):
    names = {"Idempotency-Key": "a-name-of-mine"}
    with Server(tmp_path, workers=1) as server, server.http() as http:
        shape = stored(http, small_mesh(0), parameters=FEW)
        known = {"files": {"file": ("m.ply", small_mesh(0))}, "data": {"parameters": FEW}}
        for _ in range(2):
            response = http.post("/v1/shapes", **known, headers=names)
            assert (response.status_code, response.json()["id"]) == (200, shape["id"])
        other = {"files": {"file": ("m.ply", small_mesh(1))}, "data": {"parameters": FEW}}
        ended(http, http.post("/v1/shapes", **other, headers=names))
        check(http.post("/v1/shapes", **known, headers=names), 409, "idempotency_mismatch")


@pytest.fixture
def keyed(tmp_path):
    """A client of a server whose library has keys, and a function that creates more keys."""

    def key(scope: str, **limits) -> dict[str, str]:
        with Library(str(tmp_path / "library.db")) as library:
            return {"Authorization": f"Bearer {library.keys.create('a key', scope, **limits)[1]}"}

    key("read")
    with Server(tmp_path, workers=1) as server, server.http() as http:
        yield http, key


def test_jobs_are_visible_only_to_their_key_and_to_admins(keyed):
    http, key = keyed
    mine, theirs, admin = key("write"), key("write"), key("admin")
    form = {"files": {"file": ("m.ply", endless_mesh())}, "data": {"parameters": LONG}}
    job = http.post("/v1/shapes", **form, headers=mine).json()
    path = f"/v1/jobs/{job['id']}"
    for method, address in (("GET", path), ("DELETE", path), ("GET", f"{path}/events"), ("GET", f"{path}?wait=1")):
        check(http.request(method, address, headers=theirs), 404, "not_found")
    assert http.get("/v1/jobs", headers=theirs).json()["items"] == []
    for sees in (mine, admin):
        assert http.get(path, headers=sees).json()["id"] == job["id"]
        assert [item["id"] for item in http.get("/v1/jobs", headers=sees).json()["items"]] == [job["id"]]
    assert http.delete(path, headers=admin).json()["state"] == "cancelled"
    tomorrow = {"before": (datetime.now(UTC) + timedelta(days=1)).isoformat()}
    assert http.delete("/v1/jobs", params=tomorrow, headers=theirs).json() == {"forgotten": 0}
    assert http.delete("/v1/jobs", params=tomorrow, headers=mine).json() == {"forgotten": 1}


def test_a_key_has_a_limit_of_unfinished_jobs(keyed):
    http, key = keyed
    mine, others = key("write", most_jobs=2), key("write")
    form = {"files": {"file": ("m.ply", endless_mesh())}, "data": {"parameters": LONG}}
    jobs = [http.post("/v1/queries", **form, headers=mine).json() for _ in range(2)]
    problem = http.post("/v1/queries", **form, headers=mine)
    check(problem, 429, "quota_exceeded")
    assert int(problem.headers["retry-after"]) > 0
    other = http.post("/v1/queries", **form, headers=others).json()
    for job, headers in ((jobs[0], mine), (other, others)):
        http.delete(f"/v1/jobs/{job['id']}", headers=headers)
    third = http.post("/v1/queries", **form, headers=mine)
    assert third.status_code == 202
    for job in (jobs[1], third.json()):
        http.delete(f"/v1/jobs/{job['id']}", headers=mine)


def test_an_expired_key_is_refused_and_keys_stay_required(keyed):
    http, key = keyed
    soon = key("read", expires_at=datetime.now(UTC) + timedelta(seconds=2))
    assert http.get("/v1/shapes", headers=soon).status_code == 200
    end = datetime.now(UTC) + timedelta(seconds=30)
    while http.get("/v1/shapes", headers=soon).status_code == 200:
        assert datetime.now(UTC) < end
    check(http.get("/v1/shapes", headers=soon), 401, "key_invalid")
    check(http.get("/v1/shapes"), 401, "key_required")
