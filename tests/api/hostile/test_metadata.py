"""Oversized metadata: it is refused everywhere, and oversized metadata in an old library affects no other shape."""

from __future__ import annotations

import json
import sqlite3
from contextlib import closing

import pytest

from tests.support.problem import check
from tests.support.server import SAMPLES, Server, post_mesh, small_mesh, stored
from tests.support.store import add
from unbend import Library
from unbend.errors import ParameterError

FEW = json.dumps(SAMPLES)


def nested(depth: int) -> dict:
    value: dict = {}
    for _ in range(depth - 1):
        value = {"a": value}
    return value


REFUSED = {
    "too deep": (nested(17), "nested more than 16 deep"),
    "far too deep": (nested(300), "nested more than 16 deep"),
    "too many members": ({str(number): 1 for number in range(1001)}, "more than 1000 members"),
    "too many in all": ({"a": [[0] * 600, [0] * 600]}, "more than 1000 members"),
    "too long": ({"a": "x" * 2**15}, "32768"),
    "long keys": ({"x" * 2**15: 1}, "32768"),
}
TAKEN = [nested(16), {str(number): 1 for number in range(1000)}, {"a": "x" * 32_000}, {"a": {"é": [1, None, "\u2028"]}}]


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    with Server(tmp_path_factory.mktemp("metadata"), workers=1) as running:
        yield running


@pytest.fixture(scope="module")
def shape(server) -> str:
    with server.http() as http:
        return stored(http, small_mesh(1), parameters=FEW)["id"]


@pytest.mark.parametrize("name", REFUSED)
def test_oversized_metadata_is_refused_over_http_and_in_the_library(server, shape, tmp_path, name):
    value, said = REFUSED[name]
    with server.http() as http:
        posted = post_mesh(http, small_mesh(2), parameters=FEW, metadata=json.dumps(value))
        for response in (posted, http.patch(f"/v1/shapes/{shape}", json={"metadata": value})):
            assert said in check(response, 422, "parameter_invalid")["detail"]
        assert http.get(f"/v1/shapes/{shape}").json()["metadata"] == {}
    with Library(str(tmp_path / "a.db")) as library:
        with pytest.raises(ParameterError, match=said):
            library.add(small_mesh(1), metadata=value)
        kept = add(library, b"data", "kept")
        with pytest.raises(ParameterError, match=said):
            library.change(kept.id, metadata=value)


def test_metadata_within_the_limits_is_returned_unchanged(server, shape):
    with server.http() as http:
        for value in TAKEN:
            assert http.patch(f"/v1/shapes/{shape}", json={"metadata": value}).json()["metadata"] == value
            assert http.get(f"/v1/shapes/{shape}").json()["metadata"] == value
        http.patch(f"/v1/shapes/{shape}", json={"metadata": {}})


@pytest.mark.parametrize("depth", [300, 5000])
def test_oversized_metadata_of_an_earlier_version_is_dropped_with_a_warning(tmp_path, depth):
    with Library(str(tmp_path / "library.db")) as library:
        ids = [add(library, name.encode(), name, label="a").id for name in ("one", "deep", "two")]
    text = '{"a":' * depth + "1" + "}" * depth
    with closing(sqlite3.connect(tmp_path / "library.db", isolation_level=None)) as connection:
        connection.execute("UPDATE shapes SET metadata = ? WHERE id = ?", (text, ids[1]))
    with Server(tmp_path, workers=1, ready=False) as server, server.http() as http:
        items = http.get("/v1/shapes").raise_for_status().json()["items"]
        assert [item["name"] for item in items] == ["one", "deep", "two"]
        record = http.get(f"/v1/shapes/{ids[1]}").raise_for_status().json()
        assert record == items[1]
        assert record["metadata"] == {}
        assert "metadata is nested too deeply" in record["warnings"][-1]
        assert http.patch(f"/v1/shapes/{ids[1]}", json={"metadata": {"b": 1}}).json()["warnings"] == []
