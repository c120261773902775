"""The reading of results from JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from datetime import datetime
from typing import Any


def known_fields(kind: type[Any], values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the members of `values` that are fields of a dataclass: a later service may send more."""
    return {field.name: values[field.name] for field in fields(kind) if field.name in values}


def instant(text: str | None) -> datetime | None:
    """Return the time of an ISO 8601 text."""
    return None if text is None else datetime.fromisoformat(text)
