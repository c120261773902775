"""The plain files that most obj and off files are, read at once: triangles, no colours, nothing to report.

None is returned for everything else, good or bad: the careful way reads it, or says what is wrong and where.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from unbend.arrays import Floats, Indices

_CONTINUED: Final = b"\\"
_COMMENT: Final = b"#"
_AFTER_SLASH: Final = re.compile(rb"/\S*")
_MARK: Final = -(2**62)  # before each line, so that lines of other lengths show; in double precision, too


def quick_obj(data: bytes) -> tuple[Floats, Indices] | None:
    """Return vertices and faces of an obj file whose faces are triangles with positive indices."""
    if _CONTINUED in data:
        return None
    lines = data.splitlines()
    if any(line[:1] in b" \t" for line in lines if line):
        return None
    points = [line[1:] for line in lines if line[:2] in (b"v ", b"v\t")]
    triangles = [line[1:] for line in lines if line[:2] in (b"f ", b"f\t")]
    return _mesh(points, _table(triangles, 3, np.int64, drop=_AFTER_SLASH), first=1)


def quick_off(data: bytes) -> tuple[Floats, Indices] | None:
    """Return vertices and faces of an off file of triangles, its header and counts in lines of their own."""
    lines = [line for line in data.splitlines() if line]
    if _COMMENT in data or len(lines) < 2 or lines[0].strip() != b"OFF":
        return None
    try:
        vertices, faces, _ = (int(word) for word in lines[1].split())
    except ValueError:
        return None
    if min(vertices, faces) < 0 or len(lines) != 2 + vertices + faces:
        return None
    triangles = _table(lines[2 + vertices :], 4, np.int64)
    if triangles is None or (triangles[:, 0] != 3).any():
        return None
    return _mesh(lines[2 : 2 + vertices], triangles[:, 1:], first=0)


QUICK: dict[str, Callable[[bytes], tuple[Floats, Indices] | None]] = {"obj": quick_obj, "off": quick_off}
"""Quick readers by format."""


def _mesh(points: list[bytes], corners: Any, first: int) -> tuple[Floats, Indices] | None:
    vertices = _table(points, 3, np.float64)
    if vertices is None or corners is None:
        return None
    faces = corners - first
    if faces.min() < 0 or faces.max() >= len(vertices):
        return None
    return vertices, faces


def _table(lines: list[bytes], width: int, kind: type, drop: re.Pattern[bytes] | None = None) -> Any:
    """Return lines of `width` numbers each as (len(lines), width), None if one of them is not that."""
    if not lines:
        return None
    mark = b"\n%d " % _MARK
    text = mark + mark.join(lines)
    if drop and b"/" in text:
        text = drop.sub(b"", text)
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)  # NumPy's word for what is no number
        try:
            numbers: Any = np.fromstring(text, kind, sep=" ")
        except (DeprecationWarning, ValueError, OverflowError):
            return None
    if len(numbers) != len(lines) * (width + 1):
        return None
    rows, marks = numbers.reshape(-1, width + 1), numbers == _MARK
    if marks.sum() != len(lines) or not marks[:: width + 1].all():
        return None
    return np.ascontiguousarray(rows[:, 1:])
