"""Log ratios over the number of dimensions as lines of an SVG drawing: Fig. 5."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from unbend.matching.evaluate.report.marks import MARKS

_LEFT, _TOP, _WIDTH, _HEIGHT, _LEGEND, _TICKS = 56, 12, 420, 240, 160, 4


@dataclass(frozen=True)
class Line:
    """One method's."""

    name: str
    colour: int
    mark: str
    points: tuple[tuple[float, float, int, float], ...]
    """x, y in the drawing; dimensions, log ratio."""

    @property
    def path(self) -> str:
        """The points, as SVG has them."""
        return " ".join(f"{x:.1f},{y:.1f}" for x, y, _, _ in self.points)


@dataclass(frozen=True)
class Lines:
    """The drawing."""

    lines: tuple[Line, ...]
    columns: tuple[tuple[int, float], ...]
    """Numbers of dimensions and where they stand."""
    rows: tuple[tuple[str, float], ...]
    """Log ratios of the grid and where they stand."""
    left: int = _LEFT
    top: int = _TOP
    right: int = _LEFT + _WIDTH
    bottom: int = _TOP + _HEIGHT
    width: int = _LEFT + _WIDTH + _LEGEND
    height: int = _TOP + _HEIGHT + 48


def lines(values: Mapping[str, Sequence[float]]) -> Lines:
    """Lay out a line for each of `values`: log ratios in 1, 2, ... dimensions."""
    every = [value for of in values.values() for value in of]
    low, high = math.floor(min(every)), math.ceil(max(every))
    high = max(high, low + 1)
    most = max(len(of) for of in values.values())

    def x(dimensions: int) -> float:
        return _LEFT + (dimensions - 0.5) / most * _WIDTH

    def y(value: float) -> float:
        return _TOP + (high - value) / (high - low) * _HEIGHT

    grid = [low + tick * (high - low) / _TICKS for tick in range(_TICKS + 1)]
    return Lines(
        lines=tuple(
            Line(
                name=name,
                colour=place % len(MARKS),
                mark=MARKS[place % len(MARKS)],
                points=tuple((x(m), y(value), m, value) for m, value in enumerate(of, start=1)),
            )
            for place, (name, of) in enumerate(values.items())
        ),
        columns=tuple((m, x(m)) for m in range(1, most + 1)),
        rows=tuple((f"{value:.4g}", y(value)) for value in grid),
    )
