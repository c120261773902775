"""Argument checks of the generators. Each check returns its argument or raises ParameterError."""

from __future__ import annotations

import math

from unbend.errors import ParameterError, check_choice


def between(name: str, value: float, low: float, high: float) -> float:
    """Return `value` if it is finite and low <= value <= high."""
    if not (math.isfinite(value) and low <= value <= high):
        raise ParameterError(f"{name} must be from {low:g} to {high:g}, not {value!r}")
    return float(value)


def positive(name: str, value: float) -> float:
    """Return `value` if it is finite and above zero."""
    if not (math.isfinite(value) and value > 0):
        raise ParameterError(f"{name} must be a finite number above 0, not {value!r}")
    return float(value)


def at_least(name: str, value: int, least: int, most: int = 1_000_000) -> int:
    """Return `value` if it is a whole number and least <= value <= most."""
    if not (math.isfinite(value) and value == int(value) and least <= value <= most):
        raise ParameterError(f"{name} must be a whole number from {least} to {most}, not {value!r}")
    return int(value)


def one_of(name: str, value: str, choices: tuple[str, ...]) -> str:
    """Return `value` if it is one of `choices`."""
    check_choice(name, value, choices)
    return value
