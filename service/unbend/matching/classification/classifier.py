"""What a classifier is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from unbend.arrays import Floats
from unbend.matching.classification.query import Query


class Judgement(NamedTuple):
    """How far a query is from each class of its gallery; infinitely where the class has no members."""

    remoteness: Floats
    """What classes are ordered by and confidences made from, (classes,); at least 0, in any unit."""
    distances: Floats
    """What is told of them, (classes,)."""


@dataclass(frozen=True)
class Classifier:
    """A way to compare a query with classes. Its answers depend on nothing but the query and what is stored."""

    name: str
    """What callers choose it by."""
    needs: int
    """Labelled shapes that it takes at least, a class on average."""
    reference: str
    """Where it comes from."""
    judge: Callable[[Query], Judgement]
    """ParameterError if the gallery has too few labels."""
