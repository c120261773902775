"""Queries and jobs over HTTP."""

from __future__ import annotations

import json
import time
import uuid

import numpy as np
import pytest

from tests.support.server import (
    DAMAGED,
    ENDLESS,
    Server,
    ended,
    endless_mesh,
    ply,
    post_mesh,
    small_mesh,
    stored,
    two_rings,
)
from unbend import Library, MeshPolicy, Parameters, Surface, compute_signature, read_mesh
from unbend.mesh.shapes import sphere

# Only these tests use these parameters, so that queries do not find shapes of other tests.
OWN = {"samples": 37}
FEW = json.dumps(OWN)


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    with Server(tmp_path_factory.mktemp("parts"), parts=True) as running:
        yield running


@pytest.fixture(scope="module")
def http(server):
    with server.http() as client:
        yield client


@pytest.fixture(scope="module")
def ids(http):
    """Two toruses and two spheres, by name."""
    members = {
        "ring-0": (small_mesh(0), "torus"), "ring-1": (small_mesh(1), "torus"),
        "ball-0": (ply(sphere(subdivisions=1)), "sphere"), "ball-1": (ply(sphere(subdivisions=2)), "sphere"),
    }  # fmt: skip
    return {
        name: stored(http, data, name=name, label=label, parameters=FEW)["id"]
        for name, (data, label) in members.items()
    }


def ask(http, data: bytes, headers: dict[str, str] | None = None, **fields: str):
    return http.post("/v1/queries", files={"file": ("q.ply", data)}, data={"parameters": FEW} | fields, headers=headers)


def expected(server, data: bytes, policy: MeshPolicy | None = None, **options) -> dict:
    with Library(str(server.library)) as library:
        signature = compute_signature(read_mesh(data, policy=policy), Parameters(**OWN))
        return library.rank(signature, **options).as_dict()


def test_a_query_that_prefers_to_wait_is_answered_directly(server, http, ids):
    data = small_mesh(3)
    response = ask(http, data, {"Prefer": "respond-async, wait=30"}, measure="moments", k="2")
    assert response.status_code == 200
    assert response.json() == expected(server, data, measure="moments", k=2)
    assert [match["name"] for match in response.json()["shapes"]] == ["ring-1", "ring-0"]
    assert response.json()["classes"][0]["label"] == "torus"


def test_a_piece_gets_its_whole_and_what_it_is_to_it(server, http, ids):
    ball = sphere(subdivisions=2)
    low = ball.faces[(ball.vertices[ball.faces, 2] < 0.3).all(axis=1)]
    data = ply(Surface(ball.vertices, low))
    waiting = {"Prefer": "wait=60"}
    for measure in ("partial", "partial_any_scale"):
        response = ask(http, data, waiting, measure=measure)
        assert response.status_code == 200
        found = response.json()
        assert found["measure"] == measure
        assert found["classes"][0]["label"] == "sphere"
        assert found["shapes"][0]["label"] == "sphere"
    part = ask(http, data, waiting, measure="partial").json()["shapes"][0]["part"]
    assert part["relation"] == "part"
    assert part["covered"] == pytest.approx(0.6, abs=0.1)
    assert part["scale"] == 1.0
    assert (np.linalg.norm(part["centre"]), np.linalg.norm(part["place"])) == (pytest.approx(1.0, abs=0.05),) * 2
    assert "`partial`" in ask(http, data, waiting).json()["warnings"][-1]
    stored_query = http.post("/v1/queries", json={"shape_id": ids["ball-0"], "measure": "partial"}).json()
    assert stored_query["shapes"][0]["name"] == "ball-1"
    assert stored_query["shapes"][0]["part"]["relation"] == "whole"


def test_a_server_may_leave_out_what_parts_need_and_says_so(small_server):
    with small_server.http() as http:
        stored(http, small_mesh(50), parameters=FEW)
        found = ask(http, small_mesh(51), {"Prefer": "wait=60"}, measure="partial").json()
        assert found["shapes"] == []
        assert "without local signatures" in found["warnings"][-1]
        found = ask(http, small_mesh(51), {"Prefer": "wait=60"}).json()
        assert found["shapes"]


def test_a_measure_of_parts_has_one_classifier(http, ids):
    response = http.post("/v1/queries", json={"shape_id": ids["ball-0"], "measure": "partial", "classifier": "mean"})
    assert response.status_code == 422
    assert "no classifier but nearest" in response.text


def test_a_query_is_read_by_its_policy_and_compared_with_shapes_of_any_policy(server, http, ids):
    data = ply(two_rings(0))
    answers = {
        kind: ask(http, data, {"Prefer": "wait=30"}, policy=json.dumps({"components": kind})).json()
        for kind in ("largest", "bridge")
    }
    for kind, answer in answers.items():
        assert answer == expected(server, data, MeshPolicy(components=kind))
        assert {match["id"] for match in answer["shapes"]} >= set(ids.values())
    assert answers["largest"]["shapes"][0]["distance"] < answers["bridge"]["shapes"][0]["distance"]


def test_a_query_without_a_wait_becomes_a_job_with_the_ranking_as_its_result(server, http, ids):
    data = small_mesh(4)
    response = ask(http, data)
    assert response.status_code == 202
    assert response.json()["kind"] == "query"
    job = ended(http, response)
    assert (job["state"], job["shape_id"]) == ("succeeded", None)
    assert job["result"] == expected(server, data)


def test_a_query_that_exceeds_its_wait_becomes_a_job(http, ids):
    response = ask(http, endless_mesh(), {"Prefer": "wait=1"}, parameters=json.dumps(ENDLESS))
    assert response.status_code == 202
    cancelled = http.delete(response.headers["Location"]).json()
    assert (cancelled["state"], cancelled["error"]["code"]) == ("cancelled", "job_cancelled")


def test_a_query_stores_no_shape(http, ids):
    before = http.get("/v1/shapes", params={"limit": 500}).json()
    ask(http, small_mesh(5), {"Prefer": "wait=30"}).raise_for_status()
    assert http.get("/v1/shapes", params={"limit": 500}).json() == before
    assert post_mesh(http, small_mesh(5), parameters=json.dumps({"samples": 36})).status_code == 202


def test_a_waiting_query_with_a_damaged_mesh_is_answered_with_a_failed_job(http):
    response = ask(http, DAMAGED, {"Prefer": "wait=30"})
    assert response.status_code == 202
    assert (response.json()["state"], response.json()["error"]["code"]) == ("failed", "mesh_read")


def test_a_query_by_a_stored_shape_excludes_that_shape(server, http, ids):
    response = http.post("/v1/queries", json={"shape_id": ids["ring-0"], "measure": "distribution", "k": 3})
    assert response.status_code == 200
    with Library(str(server.library)) as library:
        assert response.json() == library.rank(ids["ring-0"], measure="distribution", k=3).as_dict()
    assert set(response.json()) == {"measure", "classes", "shapes", "known", "warnings", "exact"}
    assert response.json()["shapes"][0]["name"] == "ring-1"
    assert ids["ring-0"] not in [match["id"] for match in response.json()["shapes"]]


def test_a_query_with_unused_parameters_finds_nothing_and_says_why(http, ids):
    found = ask(http, small_mesh(6), {"Prefer": "wait=30"}, parameters='{"samples": 35}').json()
    (warning,) = found.pop("warnings")
    assert found == {"measure": "spectrum", "classes": [], "shapes": [], "known": None, "exact": True}
    assert warning.startswith("no shape has the parameters of the query, samples=35: ")


@pytest.mark.parametrize(
    ("fields", "field"),
    [({"k": "0"}, "k"), ({"k": "many"}, "k"), ({"k": "1001"}, "k"), ({"limit": "3"}, "limit")],
)
def test_an_invalid_form_field_is_named(http, fields, field):
    response = ask(http, small_mesh(6), **fields)
    assert response.status_code == 422
    assert [item["field"] for item in response.json()["errors"]] == [f"body.{field}"]


@pytest.mark.parametrize("fields", [{"measure": "volume"}, {"parameters": "{"}, {"parameters": '{"samples": 3}'}])
def test_an_invalid_measure_or_parameters_are_refused_before_a_job_is_created(http, fields):
    before = http.get("/v1/jobs", params={"limit": 1}).json()
    response = ask(http, small_mesh(6), **fields)
    assert (response.status_code, response.json()["code"]) == (422, "parameter_invalid")
    assert http.get("/v1/jobs", params={"limit": 1}).json() == before


@pytest.mark.parametrize(
    "body", [{}, {"shape_id": ""}, {"shape_id": "x", "k": 0}, {"shape_id": "x", "more": 1}, [], {"shape_id": 5}]
)
def test_an_invalid_json_query_is_refused(http, body):
    assert http.post("/v1/queries", json=body).status_code == 422


def test_a_query_of_the_wrong_media_type_or_without_a_file_is_refused(http):
    assert http.post("/v1/queries", content=b"hello", headers={"Content-Type": "text/plain"}).status_code == 415
    assert http.post("/v1/queries").status_code == 415
    broken = http.post("/v1/queries", content=b"{", headers={"Content-Type": "application/json"})
    assert (broken.status_code, broken.json()["code"]) == (422, "request_invalid")
    without = http.post("/v1/queries", files={"other": ("x.ply", small_mesh(6))})
    assert without.status_code == 422
    field = http.post("/v1/queries", data={"k": "3"}, files={"measure": ("x", b"spectrum")})
    assert field.status_code == 422


def test_a_job_can_be_watched_listed_and_cancelled(http):
    accepted = post_mesh(http, endless_mesh(), parameters=json.dumps(ENDLESS))
    url = accepted.headers["Location"]
    try:
        end = time.monotonic() + 60
        while (job := http.get(url).json())["stage"] not in {"sampling", "geodesics"}:
            assert time.monotonic() < end, job
            time.sleep(0.05)
        assert (job["state"], job["position"], job["attempts"]) == ("running", None, 1)
        assert 0 <= job["progress"] < 1
        assert http.get(url, params={"wait": 0.2}).json()["state"] == "running"
        assert job["id"] in [item["id"] for item in http.get("/v1/jobs", params={"state": "running"}).json()["items"]]
        assert http.get("/v1/capacity").json()["running"] >= 1
        again = post_mesh(http, endless_mesh(), parameters=json.dumps(ENDLESS))
        assert again.status_code == 202
        assert again.json()["id"] != job["id"]  # each of the two jobs can be cancelled separately
        assert http.delete(again.headers["Location"]).json()["state"] == "cancelled"
        assert http.get(url).json()["state"] == "running"
    finally:
        cancelled = http.delete(url)
    assert cancelled.status_code == 200
    assert (cancelled.json()["state"], cancelled.json()["error"]["code"]) == ("cancelled", "job_cancelled")
    assert http.delete(url).json() == cancelled.json() == http.get(url, params={"wait": 5}).json()


def test_an_unknown_job_is_not_found(http):
    nobody = f"/v1/jobs/{uuid.uuid4().hex}"
    for response in (http.get(nobody), http.get(nobody, params={"wait": 1}), http.delete(nobody)):
        assert (response.status_code, response.json()["code"]) == (404, "not_found")


@pytest.mark.parametrize("wait", ["-1", "61", "soon", "nan"])
def test_a_wait_out_of_range_is_refused(http, wait):
    assert http.get("/v1/jobs/x", params={"wait": wait}).status_code == 422


def test_health_and_capacity_are_reported(http):
    assert http.get("/v1/livez").json() == {"status": "ok"}
    assert http.get("/v1/readyz").json() == {"status": "ok"}
    capacity = http.get("/v1/capacity").json()
    assert set(capacity) == {"workers", "running", "queued", "max_queued", "search", "recall"}
    assert capacity["workers"] == 2
    assert capacity["max_queued"] == 10_000
    assert (capacity["search"], capacity["recall"]) == ("memory", None)


@pytest.mark.parametrize("classifier", ["nearest", "vote", "mean", "discriminants"])
def test_both_kinds_of_query_accept_a_classifier(server, http, ids, classifier):
    data = small_mesh(6)
    by_file = ask(http, data, {"Prefer": "wait=30"}, classifier=classifier).json()
    assert by_file == expected(server, data, classifier=classifier)
    by_shape = http.post("/v1/queries", json={"shape_id": ids["ring-0"], "classifier": classifier})
    if classifier == "discriminants":  # without the queried torus only one torus is left, too few for this classifier
        assert (by_shape.status_code, by_shape.json()["code"]) == (409, "unsuited")
    else:
        assert by_shape.json()["classes"][0]["label"] == "torus"


def test_an_unknown_classifier_is_refused(http, ids):
    for response in (
        ask(http, small_mesh(7), classifier="oracle"),
        http.post("/v1/queries", json={"shape_id": ids["ring-0"], "classifier": "oracle"}),
    ):
        assert response.status_code == 422
        assert "oracle" in response.json()["detail"]
        assert [item["field"] for item in response.json()["errors"]] == ["body.classifier"]


def test_a_pair_measure_limits_the_number_of_results(http, ids):
    for response in (
        ask(http, small_mesh(7), measure="rigid", k="101"),
        http.post("/v1/queries", json={"shape_id": ids["ring-0"], "measure": "rigid", "k": 101}),
    ):
        assert response.status_code == 422
        assert [item["field"] for item in response.json()["errors"]] == ["body.k"]


def test_an_integer_may_have_a_decimal_point_but_not_be_text(http, ids):
    asked = {"shape_id": ids["ring-0"]}
    assert http.post("/v1/queries", json=asked | {"k": 1.0}).status_code == 200
    for k in ("1", True, 1.5):
        assert http.post("/v1/queries", json=asked | {"k": k}).status_code == 422, k
    shape = stored(http, small_mesh(9), parameters='{"samples": 40.0}')
    assert shape["parameters"]["samples"] == 40


def test_a_pair_measure_reorders_the_nearest_shapes(server, http, ids):
    data = small_mesh(8)
    answer = ask(http, data, {"Prefer": "wait=30"}, measure="rigid", k="2").json()
    assert answer == expected(server, data, measure="rigid", k=2)
    assert answer["measure"] == "rigid"


def test_the_map_contains_every_shape(http, ids):
    response = http.get("/v1/map", params={"measure": "moments", "parameters": FEW})
    assert response.status_code == 200
    reported = response.json()
    assert set(reported) == {"measure", "stress", "original_stress", "count", "items", "warnings"}
    assert {item["id"] for item in reported["items"]} >= set(ids.values())
    assert all(set(item) == {"id", "name", "label", "point", "original"} for item in reported["items"])
    solid = http.get("/v1/map", params={"parameters": FEW, "dimensions": 3, "limit": 2}).json()
    assert [len(item["point"]) for item in solid["items"]] == [3, 3]


def test_the_evaluation_has_metrics_and_a_confusion_matrix(server, http, ids):
    reported = http.get("/v1/evaluation", params={"measure": "spectrum", "parameters": FEW}).json()
    with Library(str(server.library)) as library:
        assert reported == library.evaluation(parameters=Parameters(**OWN)).as_dict()
    assert reported["nn"] == 1.0
    assert set(reported["confusion"]["labels"]) >= {"sphere", "torus"}


@pytest.mark.parametrize("path", ["/v1/map", "/v1/evaluation"])
def test_the_map_and_the_evaluation_refuse_invalid_parameters(http, path):
    for params in ({"measure": "volume"}, {"measure": "rigid"}, {"parameters": "{"}, {"parameters": '{"samples": 1}'}):
        response = http.get(path, params=params)
        assert response.status_code == 422
        assert [item["field"] for item in response.json()["errors"]] == [f"query.{next(iter(params))}"]
    if path == "/v1/map":
        assert http.get(path, params={"dimensions": 4}).status_code == 422


def test_classes_list_the_number_of_shapes_per_label(http, ids):
    classes = {item["label"]: item["count"] for item in http.get("/v1/classes").json()["items"]}
    assert classes["sphere"] >= 2
    assert all(count > 0 for count in classes.values())
    assert list(classes) == sorted(classes)


def test_default_parameters_apply_when_none_are_given(http):
    shape = stored(http, small_mesh(7))
    assert shape["parameters"] == Parameters().as_dict()
