"""OpenAPI links from responses to the requests that may follow."""

from __future__ import annotations

from typing import Any, Final

Links = dict[str, dict[str, Any]]

_OF_SHAPES: Final = {
    "get_shape": "Its record.",
    "change_shape": "Change its name, label or metadata.",
    "remove_shape": "Remove it.",
    "get_mesh": "Its mesh.",
    "get_signature": "Its signature.",
    "get_flattening": "Its mesh with texture coordinates.",
    "get_descriptors": "Its vectors.",
    "get_geodesics": "Distances on it from its first vertex.",
}
_OF_JOBS: Final = {
    "get_job": "Wait until it has ended.",
    "follow_job": "Its events.",
    "cancel_job": "Cancel it.",
}
_CONSTANTS: Final[dict[str, dict[str, Any]]] = {"get_geodesics": {"source": 0}, "get_job": {"wait": 30}}


def shape_links(place: str, *left_out: str) -> Links:
    """Return links to all requests for the shape whose id is at `place`, an OpenAPI runtime expression."""
    return {
        operation: _link(operation, description, shape_id=place)
        for operation, description in _OF_SHAPES.items()
        if operation not in left_out
    } | {"query": {"operationId": "query", "requestBody": {"shape_id": place}, "description": "What is like it."}}


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
    return {"list_shapes": _link("list_shapes", "Its members.", label="$response.body#/items/0/label")}


def _link(operation: str, description: str, **parameters: str) -> dict[str, Any]:
    given: dict[str, Any] = {**parameters, **_CONSTANTS.get(operation, {})}
    return {"operationId": operation, "parameters": given, "description": description}
