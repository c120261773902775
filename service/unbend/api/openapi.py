"""The OpenAPI document, with every error as a problem document."""

from __future__ import annotations

from typing import Any

from fastapi import FastAPI

from unbend.api.access import is_guarded, scope_of
from unbend.api.problems import MEDIA_TYPE, Problem, problem_responses

_KEY = {
    "type": "http",
    "scheme": "bearer",
    "description": "A key made by `unbend keys create`. None is needed while the library has none and is open.",
}


def install_schema(app: FastAPI) -> None:
    """Have `app` describe itself as it answers: FastAPI's own validation answer is replaced by ours."""
    generate = app.openapi

    def openapi() -> dict[str, Any]:
        if app.openapi_schema is None:
            app.openapi_schema = _with_problems(_with_keys(generate()))
        return app.openapi_schema

    app.openapi = openapi  # type: ignore[method-assign]


def _with_keys(document: dict[str, Any]) -> dict[str, Any]:
    document["components"]["securitySchemes"] = {"key": _KEY}
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            if is_guarded(path):
                scope = scope_of(method.upper(), path)
                operation["security"] = [{"key": [scope]}, {}]  # {}: or none, where the service is open
                for status, answer in problem_responses(401, *([403] if scope == "write" else []), 429).items():
                    operation["responses"].setdefault(str(status), answer)
    return document


def _with_problems(document: dict[str, Any]) -> dict[str, Any]:
    schemas = document["components"]["schemas"]
    for name in ("HTTPValidationError", "ValidationError"):
        schemas.pop(name, None)
    problem = Problem.model_json_schema(ref_template="#/components/schemas/{model}")
    schemas.update(problem.pop("$defs"))
    schemas["Problem"] = problem
    for path in document["paths"].values():
        for operation in path.values():
            for status, response in operation["responses"].items():
                if int(status) >= 400:
                    response["content"] = {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}}
    return document
