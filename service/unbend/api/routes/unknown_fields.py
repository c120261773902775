"""Refusal of unknown parameters and fields: a misspelt filter would otherwise match everything."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from typing import Final

from fastapi import Request
from fastapi.dependencies.models import Dependant
from fastapi.exceptions import RequestValidationError
from fastapi.routing import APIRoute

_MOST: Final = 10

_known: dict[int, frozenset[str]] = {}


async def no_other_parameters(request: Request) -> None:
    """Respond 422 to query parameters that the route does not have; a dependency of routes."""
    if request.scope["query_string"]:
        refuse_others("query", request.query_params, _parameters(request.scope["route"]))


def refuse_others(place: str, given: Iterable[str], known: Collection[str]) -> None:
    """Raise RequestValidationError if some of the given fields are not known."""
    others = [name for name in given if name not in known]
    if others:
        raise RequestValidationError(
            [
                {"type": "extra_forbidden", "loc": (place, name), "msg": "there is no such field", "input": None}
                for name in others[: _MOST + 1]
            ]
        )


def _parameters(route: APIRoute) -> frozenset[str]:
    if id(route) not in _known:
        _known[id(route)] = frozenset(_of(route.dependant))
    return _known[id(route)]


def _of(dependant: Dependant) -> Iterator[str]:
    yield from (field.alias for field in dependant.query_params)
    for inner in dependant.dependencies:
        yield from _of(inner)
