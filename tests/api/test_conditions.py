"""Conditional requests (ETag, If-None-Match, If-Match), and finding shapes by the hash of their file."""

from __future__ import annotations

import hashlib
import json

import pytest

from tests.support.problem import check
from tests.support.server import SAMPLES, Server, small_mesh, stored

FEW = json.dumps(SAMPLES)


@pytest.fixture(scope="module")
def http(tmp_path_factory):
    with Server(tmp_path_factory.mktemp("conditions"), workers=1) as server, server.http() as client:
        yield client


def test_the_etag_of_a_shape_changes_exactly_when_the_shape_changes(http):
    record = stored(http, small_mesh(1), parameters=FEW)
    path = f"/v1/shapes/{record['id']}"
    first = http.get(path)
    tag = first.headers["etag"]
    assert record["updated_at"] == record["created_at"]
    stored(http, small_mesh(2), parameters=FEW)  # storing another shape changes nothing
    unchanged = http.get(path, headers={"If-None-Match": f'"other", {tag}'})
    assert (unchanged.status_code, unchanged.content, unchanged.headers["etag"]) == (304, b"", tag)
    changed = http.patch(path, json={"label": "cat"})
    assert changed.headers["etag"] != tag
    again = http.get(path, headers={"If-None-Match": tag})
    assert (again.status_code, again.headers["etag"]) == (200, changed.headers["etag"])
    assert again.json() == changed.json()
    assert changed.json()["updated_at"] > record["updated_at"]


def test_a_lost_update_is_refused(http):
    path = f"/v1/shapes/{stored(http, small_mesh(3), parameters=FEW)['id']}"
    tag = http.get(path).headers["etag"]
    mine = http.patch(path, json={"label": "mine"}, headers={"If-Match": tag})
    assert mine.status_code == 200
    check(http.patch(path, json={"label": "theirs"}, headers={"If-Match": tag}), 412, "precondition_failed")
    check(http.delete(path, headers={"If-Match": tag}), 412, "precondition_failed")
    for nobodys in ('"x"', '"x.1"', f"W/{mine.headers['etag']}", '""', "nonsense"):
        check(http.patch(path, json={"label": "x"}, headers={"If-Match": nobodys}), 412, "precondition_failed")
    assert http.get(path).json()["label"] == "mine"
    either = {"If-Match": f'"x.9", {mine.headers["etag"]}'}
    assert http.patch(path, json={"label": "ours"}, headers=either).status_code == 200
    assert http.patch(path, json={"label": "any"}, headers={"If-Match": "*"}).status_code == 200
    assert http.delete(path, headers={"If-Match": http.get(path).headers["etag"]}).status_code == 204


def test_shapes_are_found_by_the_hash_of_their_file(http):
    data = small_mesh(4)
    ids = [stored(http, data, parameters=json.dumps({"samples": samples}))["id"] for samples in (40, 41)]
    digest = hashlib.sha256(data).hexdigest()
    found = http.get("/v1/shapes", params={"sha256": digest}).json()["items"]
    assert [item["id"] for item in found] == ids
    assert http.get("/v1/shapes", params={"sha256": "0" * 64}).json()["items"] == []
    check(http.get("/v1/shapes", params={"sha256": "x"}), 422, "request_invalid")
