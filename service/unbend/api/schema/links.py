"""OpenAPI links from responses to possible next requests."""

from __future__ import annotations

from typing import Any, Final

Links = dict[str, dict[str, Any]]

_OF_SHAPES: Final = {
    "get_shape": "The record of the shape.",
    "change_shape": "Change the shape's name, label or metadata.",
    "remove_shape": "Remove the shape.",
    "get_mesh": "The mesh of the shape.",
    "get_signature": "The signature of the shape.",
    "get_flattening": "The mesh with texture coordinates.",
    "get_descriptors": "The descriptors of the shape.",
    "get_geodesics": "Geodesic distances from the first vertex.",
}
_OF_JOBS: Final = {
    "get_job": "Wait until the job has ended.",
    "follow_job": "The events of the job.",
    "cancel_job": "Cancel the job.",
}
_CONSTANTS: Final[dict[str, dict[str, Any]]] = {"get_geodesics": {"source": 0}, "get_job": {"wait": 30}}


def shape_links(place: str, *left_out: str) -> Links:
    """Return links to all requests for the shape whose id is at `place`, an OpenAPI runtime expression."""
    return {
        operation: _link(operation, description, shape_id=place)
        for operation, description in _OF_SHAPES.items()
        if operation not in left_out
    } | {
        "query": {
            "operationId": "query",
            "requestBody": {"shape_id": place},
            "description": "Shapes that are similar to the shape.",
        },
        "match_shapes": {
            "operationId": "match_shapes",
            "requestBody": {"a": place, "b": place},
            "description": "The points of the shape on itself.",
        },
    }


def job_links(place: str, *left_out: str) -> Links:
    """Return links to all requests for the job whose id is at `place`."""
    return {
        operation: _link(operation, description, job_id=place)
        for operation, description in _OF_JOBS.items()
        if operation not in left_out
    }


def next_page(operation: str) -> Links:
    """Return the link from a page to the next."""
    return {"next_page": _link(operation, "The next page.", cursor="$response.body#/next_cursor")}


def members_of_class() -> Links:
    """Return the link from the classes to the members of the first."""
    return {"list_shapes": _link("list_shapes", "The members of the class.", label="$response.body#/items/0/label")}


def _link(operation: str, description: str, **parameters: str) -> dict[str, Any]:
    given: dict[str, Any] = {**parameters, **_CONSTANTS.get(operation, {})}
    return {"operationId": operation, "parameters": given, "description": description}
