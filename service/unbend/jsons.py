"""Dataclasses that survive a round trip through JSON, and parsing of JSON text."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, ClassVar, Self

from unbend.brief import assigned, brief, changed
from unbend.errors import ParameterError


@dataclass(frozen=True, repr=False)
class JsonObject:
    """Base of frozen dataclasses that check their own fields, all of them plain JSON values.

    Their `repr` has only the fields that do not have their default value.
    """

    display_name: ClassVar[str]
    """Name of the object in error messages."""

    def __repr__(self) -> str:
        return brief(self, *assigned(changed(self)))

    def as_dict(self) -> dict[str, Any]:
        """Return the fields as plain JSON values."""
        return asdict(self)

    def to_json(self) -> str:
        """Return canonical JSON: equal values give equal text."""
        return json.dumps(self.as_dict(), sort_keys=True, separators=(",", ":"))

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """Create an instance from some fields, the rest at their defaults; ParameterError names an unknown field."""
        known = {field.name for field in fields(cls)}
        unknown = sorted(set(values) - known)
        if unknown:
            raise ParameterError(
                f"{cls.display_name}: unknown field {unknown[0]!r}; known are {', '.join(sorted(known))}"
            )
        return cls(**values)

    @classmethod
    def of(cls, given: Self | Mapping[str, Any] | None) -> Self:
        """Return `given`, or an instance of its fields; all fields have their defaults if it is None."""
        if isinstance(given, Mapping) or given is None:
            return cls.from_dict(given or {})
        return given

    @classmethod
    def from_json(cls, text: str) -> Self:
        """Create an instance from JSON text; ParameterError if it is not an object of known fields."""
        values = parse_json(text, cls.display_name)
        if not isinstance(values, dict):
            raise ParameterError(f"{cls.display_name} must be a JSON object")
        return cls.from_dict({name: as_whole(value) for name, value in values.items()})


def as_whole(value: Any) -> Any:
    """Return a float without a fraction as an integer, anything else unchanged: JSON has one type of number."""
    return int(value) if isinstance(value, float) and value.is_integer() else value


def parse_json(text: str, what: str) -> Any:
    """Return the value of JSON text; ParameterError if it is not JSON, or nested too deeply."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        reason = "nested too deeply" if isinstance(error, RecursionError) else f"not JSON: {error}"
        raise ParameterError(f"{what}: {reason}") from None
