"""Checks of a shape's name, label and metadata before they are stored."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, Final, cast

from unbend.errors import ParameterError
from unbend.names import MAX_TEXT

Scalar = str | float | bool | None
"""A value of metadata that a search can ask for."""

MAX_METADATA_BYTES: Final = 2**15
"""Size limit of metadata as JSON in UTF-8."""
MAX_METADATA_DEPTH: Final = 16
MAX_METADATA_KEYS: Final = 1000
"""Largest number of members of all objects and lists together."""


def check_changes(changes: Mapping[str, Any]) -> None:
    """Check new values of a shape's name, label or metadata.

    Raises
    ------
    ParameterError
        If there is another field, the name is not text of 1 to 200 characters, the label is neither such text nor
        None, or the metadata is not an object that survives a round trip through JSON.
    """
    for name, value in changes.items():
        if name == "metadata":
            check_metadata(value)
        elif name == "name" or (name == "label" and value is not None):
            _check_text(name, value)
        elif name != "label":
            raise ParameterError(f"a shape's {name} cannot be changed")


def check_metadata(value: object) -> None:
    """Check that `value` is an object within the limits above that survives a round trip through JSON in UTF-8.

    Raises
    ------
    ParameterError
        The message names the limit or the problem.
    """
    if not isinstance(value, dict):
        raise ParameterError("metadata must be a JSON object")
    _check_extent(value)
    try:
        text = json.dumps(value, allow_nan=False, ensure_ascii=False).encode()
    except (TypeError, ValueError):
        raise ParameterError("metadata contains a value that JSON cannot represent") from None
    if len(text) > MAX_METADATA_BYTES:
        raise ParameterError(f"metadata has {len(text)} bytes as JSON, and may have {MAX_METADATA_BYTES}")


def check_filter(metadata: object) -> None:
    """Check the members of metadata that a search asks for.

    Raises
    ------
    ParameterError
        If it is not an object within the limits of metadata, or a value is an array or an object.
    """
    try:
        check_metadata(metadata)
    except ParameterError as error:
        error.field = "metadata"
        raise
    for name, value in cast("dict[str, Any]", metadata).items():
        if isinstance(value, dict | list | tuple):
            raise ParameterError(f"a search cannot ask for the array or object {name[:100]!r}", field="metadata")


def as_stored(metadata: dict[str, Any]) -> dict[str, Any]:
    """Return checked metadata as the library returns it: with lists for tuples, and text for the names of members."""
    stored: dict[str, Any] = json.loads(json.dumps(metadata))
    return stored


def read_metadata(text: str) -> dict[str, Any] | None:
    """Return stored metadata; None if it is nested more deeply than this version allows."""
    try:
        value = json.loads(text)
        _check_extent(value, most=None)
    except (RecursionError, ParameterError):
        return None
    found: dict[str, Any] = value
    return found


def _check_extent(value: object, most: int | None = MAX_METADATA_KEYS) -> None:
    """Check depth and number of members, without recursion, because the value may be nested without limit."""
    members, level = 0, [value]
    for _ in range(MAX_METADATA_DEPTH):
        containers = [part for part in level if isinstance(part, dict | list | tuple)]
        members += sum(map(len, containers))
        if most is not None and members > most:
            raise ParameterError(f"metadata has more than {most} members, counted at every depth")
        if not containers:
            return
        level = [member for part in containers for member in (part.values() if isinstance(part, dict) else part)]
    if any(isinstance(part, dict | list | tuple) for part in level):
        raise ParameterError(f"metadata is nested more than {MAX_METADATA_DEPTH} deep")


def _check_text(name: str, value: object) -> None:
    if not isinstance(value, str) or not 1 <= len(value) <= MAX_TEXT or not _encodable(value):
        raise ParameterError(f"a shape's {name} must be text of 1 to {MAX_TEXT} characters")


def _encodable(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True
