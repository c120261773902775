"""A class map as marks of an SVG drawing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from unbend.arrays import Floats
from unbend.matching.evaluate.report.marks import MARKS

WIDTH, HEIGHT, _EDGE = 460, 360, 24
MOST: Final = 2000
"""Shapes that a map shows; of more, evenly chosen ones."""


@dataclass(frozen=True)
class Mark:
    """A shape."""

    x: float
    y: float
    path: str
    colour: int
    name: str
    label: str


@dataclass(frozen=True)
class Name:
    """A class, written where its middle shape is."""

    x: float
    y: float
    text: str


@dataclass(frozen=True)
class Scatter:
    """The drawing of one measure."""

    name: str
    width: int
    height: int
    marks: tuple[Mark, ...]
    names: tuple[Name, ...]


def scatter(measure: str, points: Floats, names: Sequence[str], labels: Sequence[str]) -> Scatter:
    """Lay out shapes at `points` (n, 2), both axes on one scale."""
    places = _fitted(points)
    classes = sorted(set(labels))
    rows = np.arange(len(points)) if len(points) <= MOST else np.linspace(0, len(points) - 1, MOST).astype(int)
    number = {label: place for place, label in enumerate(classes)}
    return Scatter(
        name=measure,
        width=WIDTH,
        height=HEIGHT,
        marks=tuple(_mark(places[row], names[row], labels[row], number[labels[row]]) for row in rows),
        names=tuple(_name(places[[label == other for other in labels]], label) for label in classes),
    )


def _fitted(points: Floats) -> Floats:
    low, span = points.min(axis=0), np.ptp(points, axis=0)
    room = np.array([WIDTH, HEIGHT]) - 2 * _EDGE
    scale = float((room / np.maximum(span, np.finfo(float).tiny)).min()) if span.any() else 1.0
    middle = (np.array([WIDTH, HEIGHT]) - scale * span) / 2
    return np.asarray(middle + scale * (points - low))


def _mark(place: Floats, name: str, label: str, number: int) -> Mark:
    kinds = len(MARKS)  # the sixth class after one has its colour again, and another mark
    return Mark(float(place[0]), float(place[1]), MARKS[number // kinds % kinds], number % kinds, name, label)


def _name(places: Floats, label: str) -> Name:
    nearest = places[((places - np.median(places, axis=0)) ** 2).sum(axis=1).argmin()]
    return Name(float(nearest[0]), float(nearest[1]), label)
