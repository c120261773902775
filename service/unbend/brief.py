"""Short `repr`s: one line, also for values that contain arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, Field, fields
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


def brief(value: object, *facts: str) -> str:
    """Return the type of `value` and facts about it, such as `Surface(8 vertices, 12 faces)`, without empty facts."""
    return f"{type(value).__name__}({', '.join(fact for fact in facts if fact)})"


def counted(number: int, one: str, several: str = "") -> str:
    """Return a number and what it counts, such as `1 face` or `2 faces`; the plural ends in s by default."""
    return f"{number} {one if number == 1 else several or one + 's'}"


def noted(number: int, one: str, several: str = "") -> str:
    """Return `counted`, or nothing for 0: for things that are rare, such as warnings."""
    return counted(number, one, several) if number else ""


def counted_points(shape: tuple[int, ...]) -> str:
    """Return the shape (n, m) of points in words, such as `300 points in 3 dimensions`."""
    return f"{counted(shape[0], 'point')} in {counted(shape[1], 'dimension')}"


def assigned(values: Mapping[str, object]) -> list[str]:
    """Return each name with its value, such as `samples=300`."""
    return [f"{name}={value!r}" for name, value in values.items()]


def changed(value: DataclassInstance) -> dict[str, Any]:
    """Return the fields of a dataclass that do not have their default value."""
    values = {field.name: (getattr(value, field.name), _default(field)) for field in fields(value)}
    return {name: own for name, (own, default) in values.items() if own != default}


def _default(field: Field[Any]) -> Any:
    return field.default if field.default_factory is MISSING else field.default_factory()
