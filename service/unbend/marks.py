"""Colours and marks that tell classes apart, and the place of points in a frame, for all charts."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

COLOURS: Final = ("#0072b2", "#d55e00", "#00805e", "#b0508a", "#8a6d00", "#4d4d4d")
"""There are as many colours as marks. The style sheet of the report has the same ones for light pages."""

UNLABELLED: Final = "#8c8c8c"
"""The colour of shapes without a class."""

MARKS: Final = (
    "M-3.6 0a3.6 3.6 0 1 0 7.2 0a3.6 3.6 0 1 0 -7.2 0z",  # disc
    "M-3.2-3.2h6.4v6.4h-6.4z",  # square
    "M0-4.2L4 3.2h-8z",  # triangle
    "M0-4.6L4.6 0L0 4.6L-4.6 0z",  # diamond
    "M0 4.2L4-3.2h-8z",  # triangle pointing down
    "M-4-1.2h2.8v-2.8h2.4v2.8h2.8v2.4h-2.8v2.8h-2.4v-2.8h-2.8z",  # cross
)
"""Marks as SVG paths around the origin."""

_FLATTEST: Final = 1e-9


def look_of(place: int) -> tuple[int, int]:
    """Return the colour and the mark of a class by its place: after every six classes, colours have the next mark."""
    kinds = len(MARKS)
    return place % kinds, place // kinds % kinds


def fit_to_frame(points: NDArray[Any], width: float, height: float, edge: float) -> NDArray[np.float64]:
    """Return points (n, 2) scaled equally along both axes and moved to the middle of a frame, `edge` from its rim."""
    low, span = points.min(axis=0), np.ptp(points, axis=0)
    frame = np.array([width, height])
    least = _FLATTEST * span.max()  # points may be on a line along an axis
    scale = float(((frame - 2 * edge) / np.maximum(span, least)).min()) if least > 0 else 1.0
    margin = (frame - scale * span) / 2
    return np.asarray(margin + scale * (points - low))
