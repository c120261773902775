"""The OpenAPI document and the documentation pages."""

from __future__ import annotations

import json
import re
from dataclasses import asdict
from pathlib import Path
from urllib.parse import urljoin

import jsonschema_rs
import pytest

from unbend import MeshPolicy, Parameters, read_mesh
from unbend.api import create_app
from unbend.api.schema.fields import FILE, ParametersFields, PolicyFields
from unbend.errors import ParameterError

COMMITTED = Path(__file__).parents[2] / "openapi" / "openapi.json"


@pytest.fixture(scope="module")
def http(server):
    with server.http() as client:
        yield client


@pytest.fixture(scope="module")
def document(http) -> dict:
    return http.get("/openapi.json").raise_for_status().json()


def test_the_served_document_equals_the_generated_and_the_committed_one(document):
    assert document == json.loads(json.dumps(create_app().openapi()))
    assert document == json.loads(COMMITTED.read_text())


@pytest.mark.parametrize("page", ["/docs", "/redoc"])
def test_the_documentation_pages_load_nothing_from_other_hosts(http, page):
    response = http.get(page)
    assert response.status_code == 200
    assert not re.search(r"""(src|href|url)\s*[=:(]\s*["']?(https?:)?//""", response.text)
    assets = re.findall(r"""(?:src|href)\s*=\s*["']([^"']+)["']""", response.text)
    assert any(asset.endswith(".js") for asset in assets)
    for asset in [*assets, "/openapi.json"]:
        found = http.get(urljoin(page, asset))
        assert found.status_code == 200, asset
        assert found.content
    for sheet in (asset for asset in assets if asset.endswith(".css")):
        assert not re.search(r"url\(\s*[\"']?(https?:)?//", http.get(sheet).text)


def test_the_root_redirects_to_a_page(http):
    assert http.get("/", follow_redirects=True).status_code == 200


def operations(document: dict):
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            yield path, method, operation


def test_every_documented_operation_answers_with_a_documented_status(http, document):
    asked = 0
    for path, method, operation in operations(document):
        url = re.sub(r"\{\w+\}", "nobody", path)
        with http.stream(method, url) as response:  # the stream of all jobs has no end
            if response.is_error:
                response.read()
        assert str(response.status_code) in operation["responses"], (method, url, response.status_code)
        if response.is_error:
            assert response.headers["content-type"] == "application/problem+json"
            assert response.json()["code"] != "method_not_allowed", (method, url)
            assert "at this address" not in response.json()["detail"], (method, url)
        asked += 1
    assert asked >= 17


def test_every_operation_has_a_description_and_every_error_is_a_problem(document):
    for path, method, operation in operations(document):
        assert operation["description"], (method, path)
        for status, response in operation["responses"].items():
            if int(status) >= 400:
                assert response == {"$ref": f"#/components/responses/{status}"}
                reported = document["components"]["responses"][status]
                reference = reported["content"]["application/problem+json"]["schema"]["$ref"]
                assert reference == "#/components/schemas/Problem"
    assert "HTTPValidationError" not in json.dumps(document)


def test_every_reference_of_the_document_resolves(document):
    references = set(re.findall(r'"\$ref": "#/([^"]+)"', json.dumps(document)))
    assert references
    for reference in references:
        place = document
        for part in reference.split("/"):
            place = place[part]


def test_every_link_of_the_document_names_an_operation_and_its_parameters(document):
    calls = {call["operationId"]: call for _, _, call in operations(document)}
    assert len(calls) == sum(1 for _ in operations(document))
    links = [
        link
        for call in calls.values()
        for response in call["responses"].values()
        for link in response.get("links", {}).values()
    ]
    assert len(links) > 20
    for link in links:
        call = calls[link["operationId"]]
        given = set(link.get("parameters", {}))
        known = {parameter["name"] for parameter in call.get("parameters", [])}
        needed = {parameter["name"] for parameter in call.get("parameters", []) if parameter["required"]}
        assert needed <= given <= known


def test_the_documented_defaults_equal_the_defaults_of_the_code():
    assert ParametersFields().model_dump() == asdict(Parameters())
    assert PolicyFields().model_dump() == MeshPolicy().as_dict()


def test_the_example_file_is_a_mesh():
    (example,) = FILE["examples"]
    assert len(read_mesh(example.encode()).faces) == 4


@pytest.mark.parametrize(
    ("chosen", "allowed"),
    [
        ({"method": "classical", "weights": "area"}, True),
        ({"method": "classical", "starts": 1}, False),
        ({"method": "classical", "weights": "inverse"}, False),
        ({"method": "fast", "weights": "area"}, False),
        ({"starts": 20, "weights": "inverse_squared"}, True),
        ({"samples": "auto", "threshold": 0.5}, True),
        ({"threshold": 1.0}, False),
    ],
)
def test_the_schema_of_parameters_allows_exactly_what_the_code_accepts(chosen, allowed):
    assert jsonschema_rs.is_valid(ParametersFields.model_json_schema(), chosen) == allowed
    if allowed:
        Parameters(**chosen)
    else:
        with pytest.raises(ParameterError):
            Parameters(**chosen)
