"""Precision over recall as lines of an SVG drawing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from unbend.matching.evaluate.curves import PrecisionRecall
from unbend.matching.evaluate.report.marks import MARKS

_LEFT, _TOP, _WIDTH, _HEIGHT, _LEGEND = 56, 12, 520, 340, 200
_TICKS: Final = tuple(tick / 5 for tick in range(6))


@dataclass(frozen=True)
class Tick:
    """A line of the grid and its number."""

    text: str
    x: float
    y: float


@dataclass(frozen=True)
class Curve:
    """One measure's line."""

    name: str
    colour: int
    mark: str
    points: tuple[tuple[float, float, float, float], ...]
    """x, y in the drawing; recall, precision."""

    @property
    def line(self) -> str:
        """The points, as SVG has them."""
        return " ".join(f"{x:.1f},{y:.1f}" for x, y, _, _ in self.points)


@dataclass(frozen=True)
class Plot:
    """The drawing."""

    left: int
    top: int
    right: int
    bottom: int
    ticks: tuple[Tick, ...]
    curves: tuple[Curve, ...]
    recall: tuple[float, ...]
    """The levels, which all curves have: whose class has how many members depends on no measure."""

    @property
    def width(self) -> int:
        """With the legend, on the right."""
        return self.right + _LEGEND

    @property
    def height(self) -> int:
        """With the numbers and the name of the axis, below."""
        return self.bottom + 48


def plot(curves: Mapping[str, PrecisionRecall]) -> Plot:
    """Lay out one line for each of `curves`; both axes from 0 to 1."""
    return Plot(
        left=_LEFT,
        top=_TOP,
        right=_LEFT + _WIDTH,
        bottom=_TOP + _HEIGHT,
        ticks=tuple(Tick(f"{tick:.1f}", _x(tick), _y(tick)) for tick in _TICKS),
        curves=tuple(
            Curve(
                name=name,
                colour=place % len(MARKS),
                mark=MARKS[place % len(MARKS)],
                points=tuple(
                    (_x(recall), _y(precision), recall, precision)
                    for recall, precision in zip(curve.recall, curve.precision, strict=True)
                ),
            )
            for place, (name, curve) in enumerate(curves.items())
        ),
        recall=next(iter(curves.values())).recall,
    )


def _x(recall: float) -> float:
    return _LEFT + recall * _WIDTH


def _y(precision: float) -> float:
    return _TOP + (1.0 - precision) * _HEIGHT
