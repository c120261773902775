"""The charts of the report in SVG coordinates: precision over recall, separation, class maps and confusion matrices."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from unbend.arrays import Floats
from unbend.marks import MARKS, fit_to_frame, look_of
from unbend.matching.evaluate.evaluation import Evaluation
from unbend.matching.evaluate.metrics import PrecisionRecall

_LEFT, _TOP, _BELOW = 56, 12, 48
"""Margins of the line charts. The lower margin contains the labels and the name of the axis."""


@dataclass(frozen=True)
class Curve:
    """A line of a line chart, with a mark at each point."""

    name: str
    colour: int
    mark: str
    points: tuple[tuple[float, float, float, float], ...]
    """x and y in the chart, then the two values that they represent."""

    @property
    def line(self) -> str:
        """The points in the syntax of an SVG polyline."""
        return " ".join(f"{x:.1f},{y:.1f}" for x, y, _, _ in self.points)


@dataclass(frozen=True)
class Tick:
    """A grid line in both directions, with its label."""

    text: str
    x: float
    y: float


@dataclass(frozen=True)
class PrecisionRecallChart:
    """Precision over recall, one curve per measure."""

    ticks: tuple[Tick, ...]
    curves: tuple[Curve, ...]
    """The values of the points are recall and precision."""
    recall: tuple[float, ...]
    """The levels of recall. All curves have the same levels, which depend only on the sizes of classes."""
    left: int = _LEFT
    top: int = _TOP
    right: int = _LEFT + 520
    bottom: int = _TOP + 340
    width: int = _LEFT + 520 + 200
    """Includes the legend on the right."""
    height: int = _TOP + 340 + _BELOW


@dataclass(frozen=True)
class SeparationChart:
    """Log ratios over the number of dimensions, one curve per method: Fig. 5."""

    curves: tuple[Curve, ...]
    """The values of the points are the number of dimensions and the log ratio."""
    columns: tuple[tuple[int, float], ...]
    """Pairs of a number of dimensions and its x."""
    rows: tuple[tuple[str, float], ...]
    """Pairs of a log ratio of the grid, as text, and its y."""
    left: int = _LEFT
    top: int = _TOP
    right: int = _LEFT + 420
    bottom: int = _TOP + 240
    width: int = _LEFT + 420 + 160
    """Includes the legend on the right."""
    height: int = _TOP + 240 + _BELOW


def precision_recall_chart(by_measure: Mapping[str, PrecisionRecall]) -> PrecisionRecallChart:
    """Lay out one curve for each measure; both axes go from 0 to 1."""
    chart = PrecisionRecallChart

    def x(recall: float) -> float:
        return chart.left + recall * (chart.right - chart.left)

    def y(precision: float) -> float:
        return chart.top + (1.0 - precision) * (chart.bottom - chart.top)

    return PrecisionRecallChart(
        ticks=tuple(Tick(f"{tick:.1f}", x(tick), y(tick)) for tick in (tick / 5 for tick in range(6))),
        curves=tuple(
            _curve(
                place,
                name,
                [
                    (x(recall), y(precision), recall, precision)
                    for recall, precision in zip(each.recall, each.precision, strict=True)
                ],
            )
            for place, (name, each) in enumerate(by_measure.items())
        ),
        recall=next(iter(by_measure.values())).recall,
    )


def separation_chart(by_method: Mapping[str, Sequence[float]]) -> SeparationChart:
    """Lay out one curve for each method: its log ratios in 1, 2, ... dimensions."""
    chart, intervals = SeparationChart, 4
    values = [value for ratios in by_method.values() for value in ratios]
    low, high = math.floor(min(values)), math.ceil(max(values))
    high = max(high, low + 1)
    most = max(len(ratios) for ratios in by_method.values())

    def x(dimensions: int) -> float:
        return chart.left + (dimensions - 0.5) / most * (chart.right - chart.left)

    def y(value: float) -> float:
        return chart.top + (high - value) / (high - low) * (chart.bottom - chart.top)

    grid = [low + step * (high - low) / intervals for step in range(intervals + 1)]
    return SeparationChart(
        curves=tuple(
            _curve(place, name, [(x(m), y(value), m, value) for m, value in enumerate(ratios, start=1)])
            for place, (name, ratios) in enumerate(by_method.items())
        ),
        columns=tuple((m, x(m)) for m in range(1, most + 1)),
        rows=tuple((f"{value:.4g}", y(value)) for value in grid),
    )


def _curve(place: int, name: str, points: Sequence[tuple[float, float, float, float]]) -> Curve:
    kind = place % len(MARKS)  # each of six curves has its own mark and colour
    return Curve(name, kind, MARKS[kind], tuple(points))


_MAP_WIDTH, _MAP_HEIGHT, _MAP_EDGE = 460, 360, 24
_MAX_MAP_SHAPES: Final = 2000
"""Largest number of shapes that a class map shows. If there are more, evenly spaced rows are shown."""


@dataclass(frozen=True)
class MapMark:
    """A shape in a class map."""

    x: float
    y: float
    path: str
    colour: int
    name: str
    label: str


@dataclass(frozen=True)
class MapLabel:
    """The name of a class, placed at the shape nearest to the median of the class."""

    x: float
    y: float
    text: str


@dataclass(frozen=True)
class ClassMapChart:
    """The class map of one measure."""

    name: str
    marks: tuple[MapMark, ...]
    names: tuple[MapLabel, ...]
    width: int = _MAP_WIDTH
    height: int = _MAP_HEIGHT


def class_map_chart(measure: str, points: Floats, names: Sequence[str], labels: Sequence[str]) -> ClassMapChart:
    """Lay out shapes at `points` (n, 2), with the same scale on both axes."""
    fitted = fit_to_frame(points, _MAP_WIDTH, _MAP_HEIGHT, _MAP_EDGE)
    classes = {label: place for place, label in enumerate(sorted(set(labels)))}
    most = _MAX_MAP_SHAPES
    rows = np.arange(len(points)) if len(points) <= most else np.linspace(0, len(points) - 1, most).astype(int)
    return ClassMapChart(
        name=measure,
        marks=tuple(_map_mark(fitted[row], names[row], labels[row], classes[labels[row]]) for row in rows),
        names=tuple(_map_label(fitted[[label == other for other in labels]], label) for label in classes),
    )


def _map_mark(point: Floats, name: str, label: str, place: int) -> MapMark:
    colour, mark = look_of(place)
    return MapMark(float(point[0]), float(point[1]), MARKS[mark], colour, name, label)


def _map_label(points: Floats, label: str) -> MapLabel:
    nearest = points[((points - np.median(points, axis=0)) ** 2).sum(axis=1).argmin()]
    return MapLabel(float(nearest[0]), float(nearest[1]), label)


_CELL: Final = 22
_LONGEST_LABEL: Final = 24
_LETTER_WIDTH: Final = 6.6  # approximate pixels per letter, at the size that the style sheet gives labels


@dataclass(frozen=True)
class MatrixLabel:
    """The name of a class at a row and a column."""

    text: str
    short_text: str
    """The name, shortened if it is long."""
    middle: float
    """Distance of the middle of the row or column from the corner of the matrix."""


@dataclass(frozen=True)
class MatrixCell:
    """The number of queries of one class whose nearest shape is of a given class. Cells of 0 are not drawn."""

    x: float
    y: float
    count: int
    share: float
    """Share of the answered queries of the class."""
    label: str
    nearest_label: str

    @property
    def right(self) -> bool:
        """Whether the cell is on the diagonal."""
        return self.label == self.nearest_label


@dataclass(frozen=True)
class ConfusionChart:
    """The confusion matrix of one measure, to the right of and below its labels."""

    margin: float
    size: float
    cell: int
    labels: tuple[MatrixLabel, ...]
    cells: tuple[MatrixCell, ...]


def confusion_chart(evaluation: Evaluation) -> ConfusionChart:
    """Lay out the confusion matrix of `evaluation`."""
    counts, names = evaluation.confusion, evaluation.labels
    totals = counts.sum(axis=1)
    labels = tuple(MatrixLabel(name, _shorten(name), (place + 0.5) * _CELL) for place, name in enumerate(names))
    return ConfusionChart(
        margin=12 + _LETTER_WIDTH * max((len(label.short_text) for label in labels), default=0),
        size=float(_CELL * len(names)),
        cell=_CELL,
        labels=labels,
        cells=tuple(
            MatrixCell(
                x=float(column * _CELL),
                y=float(row * _CELL),
                count=int(counts[row, column]),
                share=float(counts[row, column] / totals[row]),
                label=names[row],
                nearest_label=names[column],
            )
            for row, column in np.argwhere(counts)
        ),
    )


def _shorten(name: str) -> str:
    return name if len(name) <= _LONGEST_LABEL else name[: _LONGEST_LABEL - 1] + "…"
