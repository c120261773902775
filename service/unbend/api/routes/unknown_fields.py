"""Refusal of unknown parameters and fields: a misspelt filter would otherwise match everything."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Collection, Iterable, Iterator
from itertools import islice
from typing import Any, Final

from fastapi import Request
from fastapi.dependencies.models import Dependant
from fastapi.exceptions import RequestValidationError
from fastapi.routing import APIRoute
from starlette.datastructures import FormData, UploadFile

from unbend.api.schema.problems import NO_FIELD, SEND_FILE

_MOST: Final = 10

_known: dict[int, frozenset[str]] = {}


async def no_other_parameters(request: Request) -> None:
    """Respond 422 to query parameters that the route does not have; a dependency of routes."""
    if request.scope["query_string"]:
        refuse_others("query", request.query_params, _parameters(request.scope["route"]))


def refuse_others(place: str, given: Iterable[str], known: Collection[str]) -> None:
    """Raise RequestValidationError if some of the given fields are not known."""
    if others := _others(place, given, known):
        raise RequestValidationError(others)


def form_of(fields: Collection[str]) -> Callable[[Request], Awaitable[None]]:
    """Return a dependency that responds 422 to a form that has no `file`, or other fields than these.

    FastAPI would report only the missing file, and not the misspelt name under which it was sent.
    """

    async def check(request: Request) -> None:
        check_form(await request.form(), fields)

    return check


def check_form(form: FormData, fields: Collection[str]) -> None:
    """Raise RequestValidationError if a form has no `file`, or other fields than these."""
    wrong = _others("body", form, fields)
    file = form.get("file")
    if not isinstance(file, UploadFile):
        message = "a file is required" if file is None else "this is text, not a file"
        wrong.insert(0, {"type": "missing", "loc": ("body", "file"), "msg": message, "advice": SEND_FILE})
    if wrong:
        raise RequestValidationError(wrong)


def _others(place: str, given: Iterable[str], known: Collection[str]) -> list[dict[str, Any]]:
    """Return the errors of the given fields that are not known; not all, if there are many."""
    advice = f"The fields are {', '.join(sorted(known))}." if known else "This request has no parameters."
    others = islice((name for name in given if name not in known), _MOST + 1)
    return [{"type": "extra_forbidden", "loc": (place, name), "msg": NO_FIELD, "advice": advice} for name in others]


def _parameters(route: APIRoute) -> frozenset[str]:
    if id(route) not in _known:
        _known[id(route)] = frozenset(_of(route.dependant))
    return _known[id(route)]


def _of(dependant: Dependant) -> Iterator[str]:
    yield from (field.alias for field in dependant.query_params)
    for inner in dependant.dependencies:
        yield from _of(inner)
