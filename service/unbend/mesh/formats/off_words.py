"""The words of an off file behind its keyword: counts, vertices and faces, as lines or as one stream."""

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
"""Corners one after the other, how many each face has, and notes."""


def in_space(points: Floats) -> Floats:
    """Return places (n, 3) from three coordinates, or from four, of which the last divides the others."""
    with np.errstate(all="ignore"):  # repair reports what is not finite
        return points[:, :3] / points[:, 3:] if points.shape[1] == 4 else points


def _check_alike(widths: Indices, strict: bool) -> None:
    if strict and len(widths) and (widths != widths[0]).any():
        raise MeshReadError("lines of the off file differ in what they hold")


def _vertex_lines(text: bytes) -> int | None:
    """Return how many lines hold the counts and the vertices, if each has its own line and none is blank."""
    found = _FIRST_COUNT.match(text)
    return int(found.group(1)) + text.count(b"\n", 0, found.start(1)) + 1 if found else None


@dataclass(frozen=True)
class Body:
    """All numbers, and where each line with numbers begins among them."""

    lines: list[bytes]
    first: int
    """The number of the first of `lines` in the file."""
    values: Floats
    starts: Indices
    widths: Indices
    indices: Indices
    """The index in `lines` of each line with numbers."""
    broken: int | None
    """The index of the first line that holds something else than numbers; nothing behind it was read."""

    @classmethod
    def of(cls, text: bytes, first: int) -> Body:
        """Read text, whose first line has the number `first` in the file."""
        rows = table(text, _vertex_lines(text))
        filled = np.flatnonzero(rows.widths)
        return cls(text.split(b"\n"), first, rows.values, rows.starts[filled], rows.widths[filled], filled, rows.broken)

    def without_dimension(self) -> Body:
        """Return the body behind the dimension, which must be three."""
        if self.values[:1].tolist() != [3.0]:
            raise MeshFormatError(f"line {self._number(0)}: the off file is not of three dimensions")
        widths = self.widths.copy()
        widths[0] -= 1
        starts = np.maximum(self.starts - 1, 0)
        kept = widths > 0
        return replace(
            self, values=self.values[1:], starts=starts[kept], widths=widths[kept], indices=self.indices[kept]
        )

    def counts(self) -> tuple[int, int]:
        """Return how many vertices and faces are announced."""
        found = self.values[:2]
        if len(found) < 2 or not (np.isfinite(found) & (np.floor(found) == found)).all():
            raise MeshReadError(f"line {self._number(0)}: the counts of vertices and faces are missing")
        if found.min() < 0:
            raise MeshReadError(f"line {self._number(0)}: a count is negative")
        return int(found[0]), int(found[1])

    def behind_counts(self) -> Iterator[int]:
        """Yield where the vertices may begin: behind two counts if the line ends there, and behind three."""
        if 2 in self.starts[:3]:
            yield 2
        yield 3

    def vertices(
        self, begin: int, count: int, coordinates: int, columns: int | None, *, strict: bool
    ) -> tuple[Floats, int]:
        """Return (count, 3) vertices and where the next word is.

        With `columns`, each vertex has so many words. Without, each has a line, and if `strict` all lines have as many
        words. The first three or four words of a vertex are coordinates.
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
        """Return the faces, each from a line of its own, or `by_words` from one stream.

        A stream must end with the last face. If `strict`, so must the lines, and they must be alike. Only lines that
        are not read strictly may hold faces of fewer than three corners.
        """
        if by_words:
            return self._faces_by_words(begin, count, vertices)
        line, end_line = self._lines(begin, count)
        firsts, widths = self.starts[line:end_line], self.widths[line:end_line]
        counts = self.values[firsts]
        wrong = np.flatnonzero(~((counts >= 0) & (np.floor(counts) == counts) & (counts < widths)))
        if len(wrong):
            at = int(wrong[0])
            raise self._wrong(line + at, f"a face with {widths[at] - 1} of {counts[at]:.15g} corners")
        sizes = counts.astype(np.int64)
        _check_alike(widths - sizes, strict)
        if strict and ((sizes < 3).any() or end_line < len(self.starts) or self.broken is not None):
            raise MeshReadError("lines of the off file are not all faces")

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
            raise MeshReadError("the off file goes on behind its last face")
        found, sizes = rows.columns["corners"]
        if (sizes < 3).any():  # a stream with a word too few or too many gives such faces
            raise MeshReadError("a face of the off file has fewer than three corners")
        corners = whole(found, sizes, "face {}".format)
        check_corners(corners, sizes, vertices, "face {}".format)
        return corners, sizes, ()

    def _lines(self, begin: int, count: int) -> tuple[int, int]:
        """Return the range of `count` lines, the first of which begins with the number at `begin`."""
        line = int(np.searchsorted(self.starts, begin))
        if begin < len(self.values) and self._start(line) != begin:
            raise MeshReadError(f"line {self._number(line - 1)}: not as many numbers as announced")
        if line + count > len(self.starts):
            raise self._early(count, len(self.starts) - line, begin)
        return line, line + count

    def _start(self, line: int) -> int:
        return int(self.starts[line]) if line < len(self.starts) else len(self.values)

    def _number(self, line: int) -> int:
        """Return the number of a line in the file; behind the last line read, that of the broken one or of the end."""
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
