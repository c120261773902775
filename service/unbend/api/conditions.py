"""Conditional requests (RFC 9110, section 13): what a caller has already, and what it expects to change."""

from __future__ import annotations

import re
from collections.abc import Collection
from typing import Final

from starlette.datastructures import Headers

from unbend.library.records import ShapeRecord

_TAG: Final = re.compile(r'(W/)?"([\x21\x23-\x7e\x80-\xff]*)"')


def etag_of(record: ShapeRecord) -> str:
    """Return the entity tag of a shape's record: another one after each change."""
    return f'"{record.id}.{record.changed}"'


def is_known(headers: Headers, tag: str) -> bool:
    """Return whether If-None-Match says that the caller has what `tag` stands for."""
    given = headers.get("if-none-match", "")
    return given.strip() == "*" or tag in {f'"{text}"' for _, text in _TAG.findall(given)}


def expected_revisions(headers: Headers, shape_id: str) -> Collection[int] | None:
    """Return the revisions of a shape that If-Match allows; None where every one is allowed."""
    given = headers.get("if-match")
    if given is None or given.strip() == "*":
        return None
    tags = (text.rpartition(".") for weak, text in _TAG.findall(given) if not weak)
    return frozenset(int(number) for of, _, number in tags if of == shape_id and re.fullmatch(r"\d{1,18}", number))
