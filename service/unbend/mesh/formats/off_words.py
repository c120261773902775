"""The words of an off file after its keyword: counts, vertices and faces, in lines or in one stream."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from unbend.arrays import Floats, Indices
from unbend.errors import MeshFormatError, MeshReadError
from unbend.mesh.formats.corners import check_corners, whole
from unbend.mesh.formats.parsed import left_over
from unbend.mesh.formats.records import Field, read_rows
from unbend.mesh.formats.spans import spans
from unbend.mesh.formats.text import shown, table

_FIRST_COUNT = re.compile(rb"\s*(\d{1,18})\s")
_FACE = (Field("corners", "<f8", "<f8"),)

Polygons = tuple[Indices, Indices, tuple[str, ...]]
"""The corners of all faces in one array, the number of corners of each face, and notes."""


def in_space(points: Floats) -> Floats:
    """Return points (n, 3) from three coordinates, or from four, the last of which divides the others."""
    with np.errstate(all="ignore"):  # repair reports coordinates that are not finite
        return points[:, :3] / points[:, 3:] if points.shape[1] == 4 else points


def _check_alike(widths: Indices, strict: bool) -> None:
    if strict and len(widths) and (widths != widths[0]).any():
        raise MeshReadError("lines of the off file have different numbers of values")


def _vertex_lines(text: bytes) -> int | None:
    """Return the number of lines up to the last vertex; None if the text does not begin with a count.

    It is a guess: it assumes that each vertex has its own line, and that no line after the first count is blank.
    """
    found = _FIRST_COUNT.match(text)
    return int(found.group(1)) + text.count(b"\n", 0, found.start(1)) + 1 if found else None


@dataclass(frozen=True)
class Body:
    """The numbers of a file, and the structure of its lines."""

    lines: list[bytes]
    first: int
    """The line number in the file of the first of `lines`."""
    values: Floats
    starts: Indices
    widths: Indices
    indices: Indices
    """The index in `lines` of each line with numbers."""
    broken: int | None
    """The index of the first line that contains anything but numbers. The lines from there on were not read."""

    @classmethod
    def of(cls, text: bytes, first: int) -> Body:
        """Parse text whose first line has the number `first` in the file."""
        rows = table(text, _vertex_lines(text))
        filled = np.flatnonzero(rows.widths)
        return cls(text.split(b"\n"), first, rows.values, rows.starts[filled], rows.widths[filled], filled, rows.broken)

    def without_dimension(self) -> Body:
        """Return the body without its first number, the dimension, which must be three."""
        if self.values[:1].tolist() != [3.0]:
            raise MeshFormatError(f"line {self._number(0)}: the off file is not three-dimensional")
        widths = self.widths.copy()
        widths[0] -= 1
        starts = np.maximum(self.starts - 1, 0)
        kept = widths > 0
        return replace(
            self, values=self.values[1:], starts=starts[kept], widths=widths[kept], indices=self.indices[kept]
        )

    def counts(self) -> tuple[int, int]:
        """Return the announced numbers of vertices and faces."""
        found = self.values[:2]
        if len(found) < 2 or not (np.isfinite(found) & (np.floor(found) == found)).all():
            raise MeshReadError(f"line {self._number(0)}: the counts of vertices and faces are missing")
        if found.min() < 0:
            raise MeshReadError(f"line {self._number(0)}: a count is negative")
        return int(found[0]), int(found[1])

    def behind_counts(self) -> Iterator[int]:
        """Yield where the vertices may begin: after two counts if a line ends there, and after three."""
        if 2 in self.starts[:3]:
            yield 2
        yield 3

    def vertices(
        self, begin: int, count: int, coordinates: int, columns: int | None, *, strict: bool
    ) -> tuple[Floats, int]:
        """Return the vertices (count, 3), and the index of the first number after them.

        With `columns`, each vertex has that many numbers, wherever lines end. Without, each vertex has its own line. If
        `strict`, all these lines must have the same number of values. A vertex begins with its coordinates.
        """
        if columns is not None:
            end = begin + count * columns
            if end > len(self.values):
                raise self._early(count, 0, begin)
            points = self.values[begin:end].reshape(count, columns)[:, :coordinates]
            return in_space(points), end
        line, end_line = self._lines(begin, count)
        short = np.flatnonzero(self.widths[line:end_line] < coordinates)
        if len(short):
            raise self._wrong(line + int(short[0]), f"{'four' if coordinates == 4 else 'three'} coordinates expected")
        _check_alike(self.widths[line:end_line], strict)
        places = self.starts[line:end_line, None] + np.arange(coordinates)
        return in_space(self.values[places]), self._start(end_line)

    def faces(self, begin: int, count: int, vertices: int, *, by_words: bool, strict: bool) -> Polygons:
        """Return the faces, each from its own line, or, if `by_words`, from one stream of numbers.

        A stream must end with the last face and have no face of fewer than three corners. If `strict`, the same is
        true of lines, and all faces must have the same number of values after their corners.
        """
        if by_words:
            return self._faces_by_words(begin, count, vertices)
        line, end_line = self._lines(begin, count)
        firsts, widths = self.starts[line:end_line], self.widths[line:end_line]
        counts = self.values[firsts]
        wrong = np.flatnonzero(~((counts >= 0) & (np.floor(counts) == counts) & (counts < widths)))
        if len(wrong):
            at = int(wrong[0])
            raise self._wrong(line + at, f"a face has {widths[at] - 1} of {counts[at]:.15g} corners")
        sizes = counts.astype(np.int64)
        _check_alike(widths - sizes, strict)
        if strict and ((sizes < 3).any() or end_line < len(self.starts) or self.broken is not None):
            raise MeshReadError("some lines of the off file are not faces")

        def where(face: int) -> str:
            return f"line {self._number(line + face)}"

        corners = whole(self.values[spans(firsts + 1, sizes)], sizes, where)
        check_corners(corners, sizes, vertices, where)
        last = self.indices[end_line - 1] if end_line else -1
        behind = sum(1 for text in self.lines[last + 1 :] if text.strip())
        return corners, sizes, left_over(behind, "line")

    def _faces_by_words(self, begin: int, count: int, vertices: int) -> Polygons:
        rows = read_rows(self.values.tobytes(), 8 * begin, count, _FACE)
        if rows.end != 8 * len(self.values) or self.broken is not None:
            raise MeshReadError("the off file continues after its last face")
        found, sizes = rows.columns["corners"]
        if (sizes < 3).any():  # a missing or an additional word in the stream causes such faces
            raise MeshReadError("a face of the off file has fewer than three corners")
        corners = whole(found, sizes, "face {}".format)
        check_corners(corners, sizes, vertices, "face {}".format)
        return corners, sizes, ()

    def _lines(self, begin: int, count: int) -> tuple[int, int]:
        """Return the range of `count` lines, the first of which begins with the number at `begin`."""
        line = int(np.searchsorted(self.starts, begin))
        if begin < len(self.values) and self._start(line) != begin:
            raise MeshReadError(f"line {self._number(line - 1)}: the vertices or faces do not begin on a new line")
        if line + count > len(self.starts):
            raise self._early(count, len(self.starts) - line, begin)
        return line, line + count

    def _start(self, line: int) -> int:
        return int(self.starts[line]) if line < len(self.starts) else len(self.values)

    def _number(self, line: int) -> int:
        """Return the line number in the file of entry `line` of `indices`, or else of the broken or the last line."""
        if line < len(self.indices):
            return self.first + int(self.indices[line])
        return self.first + (len(self.lines) - 1 if self.broken is None else self.broken)

    def _wrong(self, line: int, expected: str) -> MeshReadError:
        text = self.lines[self.indices[line]]
        return MeshReadError(f"line {self._number(line)}: {expected}, found {shown(text)}")

    def _early(self, announced: int, found: int, begin: int) -> MeshReadError:
        if self.broken is not None:
            return MeshReadError(
                f"line {self.first + self.broken}: numbers expected, found {shown(self.lines[self.broken])}"
            )
        place = f"line {self._number(len(self.indices) - 1)}"
        what = "vertices" if begin <= 3 else "faces"
        return MeshReadError(f"{place}: the file ends early: {announced} {what} announced, {max(found, 0)} lines found")
