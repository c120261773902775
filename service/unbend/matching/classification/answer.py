"""What a query is answered."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ClassMatch:
    """A class that a query may belong to."""

    label: str
    distance: float
    """How far it is from the query, as the classifier has it: from its nearest member, from its mean."""
    confidence: float
    """The probability, 0 to 1, that it is the query's class, if that is one of those in the library."""


@dataclass(frozen=True)
class Classification:
    """All classes, best first, and whether the best is near enough."""

    matches: list[ClassMatch]
    """Of equally good ones, in the order of their labels."""
    known: bool | None
    """False where the query is too far from the best class to be of it; None where nothing can be said."""
