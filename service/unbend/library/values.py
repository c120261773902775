"""What a shape's name, label and metadata may be: checked once, before they are stored."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from unbend.errors import ParameterError
from unbend.names import MAX_TEXT


def check_changes(changes: Mapping[str, Any]) -> None:
    """Check some of a shape's name, label and metadata.

    Raises
    ------
    ParameterError
        If there is another member, the name is not text of 1 to 200 characters, the label neither that nor None,
        or the metadata not an object that JSON can give back as it is.
    """
    for name, value in changes.items():
        if name == "metadata":
            check_metadata(value)
        elif name == "name" or (name == "label" and value is not None):
            _check_text(name, value)
        elif name != "label":
            raise ParameterError(f"a shape's {name} cannot be changed")


def check_metadata(value: object) -> None:
    """Check that `value` is an object that JSON, and UTF-8, can give back as it is; else ParameterError."""
    if not isinstance(value, dict):
        raise ParameterError("metadata must be a JSON object")
    try:
        json.dumps(value, allow_nan=False, ensure_ascii=False).encode()
    except (TypeError, ValueError, RecursionError):
        raise ParameterError("metadata holds something that JSON cannot give back, or is nested too deeply") from None


def _check_text(name: str, value: object) -> None:
    if not isinstance(value, str) or not 1 <= len(value) <= MAX_TEXT or not _encodable(value):
        raise ParameterError(f"a shape's {name} must be text of 1 to {MAX_TEXT} characters")


def _encodable(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True
