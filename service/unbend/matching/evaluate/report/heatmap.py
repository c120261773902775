"""The confusion matrix as cells of an SVG drawing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from unbend.matching.evaluate.evaluation import Evaluation

CELL: Final = 22
_LONGEST_LABEL: Final = 24
_LETTER: Final = 6.6  # pixels of a letter, about, at the size that the style sheet gives labels


@dataclass(frozen=True)
class Label:
    """A class' name beside its row and above its column."""

    text: str
    shown: str
    """Cut, where it is long."""
    middle: float
    """Of its row, or column, from the matrix' corner."""


@dataclass(frozen=True)
class Cell:
    """How many queries of a class were answered with a class; only cells that are not 0 are drawn."""

    x: float
    y: float
    count: int
    share: float
    """Of the class' answered queries."""
    label: str
    nearest_label: str

    @property
    def right(self) -> bool:
        """Whether it lies on the diagonal."""
        return self.label == self.nearest_label


@dataclass(frozen=True)
class HeatMap:
    """The drawing: the matrix lies right of and below its labels."""

    margin: float
    size: float
    cell: int
    labels: tuple[Label, ...]
    cells: tuple[Cell, ...]


def heat_map(evaluation: Evaluation) -> HeatMap:
    """Lay out the confusion matrix of `evaluation`."""
    counts, names = evaluation.confusion, evaluation.labels
    totals = counts.sum(axis=1)
    labels = tuple(Label(name, _cut(name), (place + 0.5) * CELL) for place, name in enumerate(names))
    return HeatMap(
        margin=12 + _LETTER * max((len(label.shown) for label in labels), default=0),
        size=float(CELL * len(names)),
        cell=CELL,
        labels=labels,
        cells=tuple(
            Cell(
                x=float(column * CELL),
                y=float(row * CELL),
                count=int(counts[row, column]),
                share=float(counts[row, column] / totals[row]),
                label=names[row],
                nearest_label=names[column],
            )
            for row, column in np.argwhere(counts)
        ),
    )


def _cut(name: str) -> str:
    return name if len(name) <= _LONGEST_LABEL else name[: _LONGEST_LABEL - 1] + "…"
