"""Content negotiation by the Accept header (RFC 9110, sections 12.4.2 and 12.5.1)."""

from __future__ import annotations

import pytest
from fastapi import Request

from unbend.api.routes.downloads import choose_format
from unbend.api.schema.problems import ProblemError


def chosen(*accept: str, wanted: str | None = None, default: str = "json") -> str:
    headers = [(b"accept", value.encode()) for value in accept]
    return choose_format(Request({"type": "http", "headers": headers}), wanted, default)


@pytest.mark.parametrize(
    ("accept", "expected"),
    [
        ("", "json"),
        ("*/*", "json"),
        ("application/octet-stream", "json"),
        ("model/obj", "obj"),
        ("Model/OBJ", "obj"),
        ("text/html, model/obj;q=0.9", "obj"),
        ("text/html, */*;q=0.1", "json"),
        ("model/obj;q=0.3, model/vnd.off;q=0.8", "off"),
        ("model/vnd.off;q=0.8, model/obj;q=0.3", "off"),
        ("application/json;q=0, */*", "ply"),
        ("model/*", "obj"),
        ("model/*;q=0.5, model/gltf-binary", "glb"),
        ("model/*, model/obj;q=0", "off"),
        ("*/*;q=0.5, model/*;q=0.6, model/obj;q=0.1", "off"),
        ("application/*", "json"),
        ("application/json;charset=utf-8", "json"),
        ("model/obj ; Q=0.2 , application/json; q=0.1", "obj"),
        ("model/obj;q=2, model/vnd.off;q=0.1", "off"),
        ("model/obj;q=high, model/vnd.off;q=0.1", "off"),
        (", ,model/obj,", "obj"),
    ],
)
def test_the_preferred_acceptable_format_is_chosen(accept, expected):
    assert chosen(accept) == expected


@pytest.mark.parametrize(
    "accept", ["text/html", "image/*", "*/*;q=0", "model/stl", "model/obj;q=0.0", "model/obj;q=9", "x"]
)
def test_an_accept_header_without_a_served_format_is_refused(accept):
    with pytest.raises(ProblemError) as caught:
        chosen(accept)
    assert caught.value.status_code == 406
    assert "model/obj" in caught.value.detail


def test_several_accept_headers_are_combined():
    assert chosen("text/html", "model/obj") == "obj"


def test_a_format_in_the_query_wins_and_no_header_gives_the_default():
    assert chosen(default="stl") == "stl"
    assert chosen("model/stl", default="stl") == "stl"
    assert chosen("text/html", wanted="glb") == "glb"
