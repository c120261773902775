"""The OpenAPI document: adds the headers and errors of every request, and describes errors as problem documents."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from fastapi import FastAPI

from unbend.api.context import REQUEST_ID, is_guarded, scope_of
from unbend.api.schema.problems import Problem, problem_responses

_KEY = {
    "type": "http",
    "scheme": "bearer",
    "description": "A key from `unbend keys create`. A library without keys needs none.",
}
_REQUEST_ID = {
    "description": "The id that the request sent, if it is valid, otherwise a new id. Log lines contain it too.",
    "required": True,
    "schema": {"type": "string", "pattern": "^[A-Za-z0-9._:+/=@-]{1,128}$"},
}
_ID_HEADER = {REQUEST_ID: {"$ref": f"#/components/headers/{REQUEST_ID}"}}
_STATUS_HEADERS: dict[int, dict[str, Any]] = {
    401: {"WWW-Authenticate": {"description": "RFC 6750.", "required": True, "schema": {"type": "string"}}},
    403: {"WWW-Authenticate": {"description": "With code `scope_insufficient`.", "schema": {"type": "string"}}},
    429: {
        "Retry-After": {
            "description": "Seconds to wait.", "required": True, "schema": {"type": "integer", "minimum": 1},
        }
    },
}  # fmt: skip


def install_schema(app: FastAPI) -> None:
    """Install the document in `app`, with problem documents in place of FastAPI's validation errors."""
    generate = app.openapi

    def openapi() -> dict[str, Any]:
        if app.openapi_schema is None:
            app.openapi_schema = _completed(generate())
        return app.openapi_schema

    app.openapi = openapi  # type: ignore[method-assign]


def _completed(document: dict[str, Any]) -> dict[str, Any]:
    components = document["components"]
    components["securitySchemes"] = {"key": _KEY}
    components["headers"] = {REQUEST_ID: _REQUEST_ID}
    _add_problem(components["schemas"])
    for name, schema in components["schemas"].items():
        if name.startswith("Body_"):  # forms: unknown fields are refused
            schema["additionalProperties"] = False
    for path, method, operation in _operations(document):
        if is_guarded(path):
            _add_keys(operation, scope_of(method.upper(), path))
        for parameter in operation.get("parameters", []):
            _as_sent(parameter)
        statuses = (400, 408, 413) if "requestBody" in operation else ()
        for status, response in problem_responses(*statuses, 500, 503).items():
            operation["responses"].setdefault(str(status), response)
        errors = {status: None for status in operation["responses"] if int(status) >= 400}
        components.setdefault("responses", {}).update(errors)
        for response in operation["responses"].values():
            response["headers"] = response.get("headers", {}) | _ID_HEADER
        references = {status: {"$ref": f"#/components/responses/{status}"} for status in errors}
        operation["responses"] = dict(sorted((operation["responses"] | references).items()))
    components["responses"] = {status: _error(int(status)) for status in sorted(components["responses"])}
    return document


def _operations(document: dict[str, Any]) -> Iterator[tuple[str, str, dict[str, Any]]]:
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            yield path, method, operation


def _add_problem(schemas: dict[str, Any]) -> None:
    for name in ("HTTPValidationError", "ValidationError"):
        schemas.pop(name, None)
    problem = Problem.model_json_schema(mode="serialization", ref_template="#/components/schemas/{model}")
    schemas.update(problem.pop("$defs"))
    schemas["Problem"] = problem


def _add_keys(operation: dict[str, Any], scope: str) -> None:
    operation["security"] = [{"key": [scope]}, {}]  # {}: no key if the service is open
    for status, response in problem_responses(401, *([403] if scope == "write" else []), 429).items():
        operation["responses"].setdefault(str(status), response)


def _as_sent(parameter: dict[str, Any]) -> None:
    """Describe a parameter as requests send it: never null, and objects as JSON text."""
    schema = parameter["schema"]
    if len(types := [each for each in schema.get("anyOf", []) if each != {"type": "null"}]) == 1:
        del schema["anyOf"]
        parameter["schema"] = {**types[0], **schema}
    if parameter["in"] == "query" and schema.get("type") == "object":
        parameter["content"] = {"application/json": {"schema": parameter.pop("schema")}}


def _error(status: int) -> dict[str, Any]:
    return problem_responses(status)[status] | {"headers": _STATUS_HEADERS.get(status, {}) | _ID_HEADER}
