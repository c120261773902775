"""off files: a keyword, counts, vertices and polygons, as words or in binary.

The format is Geomview's, http://www.geomview.org/docs/html/OFF.html. Other programs omit the keyword or the count of
edges, write the counts on the line of the keyword, and add numbers to vertices and faces. Lines may break anywhere, but
the numbers after a face's corners on the same line are its colour. So the reader first takes each line as a row,
provided that all rows have the same structure. If they do not, it takes the file as one stream of words without
colours, which must end with the last face. If that fails too, it takes each line as a row of any structure.
"""

from __future__ import annotations

import contextlib
import itertools
import re
import struct
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from unbend.arrays import Floats, Ints
from unbend.errors import MeshFormatError, MeshReadError
from unbend.mesh.formats.corners import check_corners
from unbend.mesh.formats.off_words import Body, in_space
from unbend.mesh.formats.parsed import MeshFormat, ParsedMesh, left_over, words_cut
from unbend.mesh.formats.polygons import triangulated
from unbend.mesh.formats.records import Field, read_rows
from unbend.mesh.formats.text import MARK, leading_numbers, lines_of, plain, without_comments
from unbend.mesh.limits import MeshLimits

_HEADER: Final = 2**16  # bytes that are searched for the counts
_BLANK: Final = rb"(?:\s|#[^\n]*\n)"
_KEY: Final = rb"((?:ST|C|N|4){0,5}OFF)"  # in any order, because MeshLab's order is not Geomview's
_BEGIN: Final = re.compile(rb"(?:%b)?%b*%b(?=[ \t]*(?:[\d#\r\n]|BINARY|$))" % (MARK, _BLANK, _KEY), re.IGNORECASE)
_BINARY: Final = re.compile(rb"(?:%b)?%b*%b[ \t]+BINARY[ \t]*(?:\r\n|\r|\n)" % (MARK, _BLANK, _KEY), re.IGNORECASE)
_COUNTS: Final = re.compile(rb"%b*(\d{1,18})%b+(\d{1,18})\b" % (_BLANK, _BLANK))


@dataclass(frozen=True)
class _Key:
    """The keyword, which defines the numbers of each vertex."""

    word: bytes

    @property
    def prefix(self) -> bytes:
        return (self.word if self.word.endswith(b"nOFF") else self.word.upper())[:-3]

    @property
    def any_dimension(self) -> bool:
        return b"n" in self.prefix

    @property
    def coordinates(self) -> int:
        """Number of coordinates of a vertex; the fourth divides the other three."""
        return 4 if b"4" in self.prefix else 3

    @property
    def widths(self) -> tuple[int, ...]:
        """Possible counts of the numbers of a vertex, because a colour has three or four."""
        least = self.coordinates + 3 * (b"N" in self.prefix) + 2 * (b"ST" in self.prefix)
        return (least + 4, least + 3) if b"C" in self.prefix else (least,)


def recognises(data: bytes) -> bool:
    """Return whether a file begins with the keyword, followed by counts, a comment, BINARY or the end of the line."""
    return bool(_BEGIN.match(data[:4096]))


def announced(data: bytes) -> tuple[int, int]:
    """Return the counts after the keyword."""
    head = data[:_HEADER]
    begin = _BEGIN.match(head)
    found = _COUNTS.match(head, begin.end() if begin else 0)
    return (int(found.group(1)), int(found.group(2))) if found else (0, 0)


def read(data: bytes, limits: MeshLimits) -> ParsedMesh:
    """Return the mesh of an off file. A file without a keyword begins with its counts."""
    if binary := _BINARY.match(data[:_HEADER]):
        return _read_binary(data, binary.end(), _Key(binary.group(1)), limits)
    text = without_comments(plain(data))
    begin = _BEGIN.match(text[:_HEADER])
    key, end = (_Key(begin.group(1)), begin.end()) if begin else (_Key(b"OFF"), 0)
    line = text.count(b"\n", 0, end) + 1
    try:
        return _parse(Body.of(text[end:], line), key, limits)
    except MeshReadError:
        cut, lines = leading_numbers(text[end:])
        if not lines:
            raise
        with contextlib.suppress(MeshReadError):
            parsed = _parse(Body.of(cut, line), key, limits, lines_only=True)
            return replace(parsed, notes=words_cut(lines) + parsed.notes)
        raise


def _parse(body: Body, key: _Key, limits: MeshLimits, *, lines_only: bool = False) -> ParsedMesh:
    body = body.without_dimension() if key.any_dimension else body
    vertices, faces = body.counts()
    limits.check(vertices, faces)
    refused: list[MeshReadError] = []
    for strict in (True, False):
        refused = []
        widths = (None,) if lines_only else (None, *key.widths)
        ways = itertools.product(body.behind_counts(), widths, (False,) if lines_only else (False, True))
        for begin, columns, by_words in ways:
            try:
                points, end = body.vertices(begin, vertices, key.coordinates, columns, strict=strict)
                corners, counts, notes = body.faces(end, faces, vertices, by_words=by_words, strict=strict)
            except MeshReadError as error:
                refused.append(error)
                continue
            triangles, more = triangulated(points, corners, counts, limits)
            return ParsedMesh(points, triangles, notes + more)
    raise refused[0]


def _read_binary(data: bytes, begin: int, key: _Key, limits: MeshLimits) -> ParsedMesh:
    if key.any_dimension:
        if data[begin : begin + 4] != struct.pack(">i", 3):
            raise MeshFormatError("the off file is not three-dimensional")
        begin += 4
    if begin + 12 > len(data):
        raise MeshReadError("the off file ends before its counts")
    vertices, faces, _ = struct.unpack_from(">3i", data, begin)
    if min(vertices, faces) < 0:
        raise MeshReadError("a count of the off file is negative")
    limits.check(vertices, faces)
    numbers = tuple(Field(str(number), ">f4") for number in range(key.widths[0]))
    rows = read_rows(data, begin + 12, vertices, numbers)
    points = np.stack([rows.columns[str(axis)][0] for axis in range(key.coordinates)], axis=1).astype(np.float64)
    lists = Field("corners", ">i4", ">i4"), Field("colour", ">f4", ">i4")
    rows = read_rows(data, rows.end, faces, lists)
    corners, counts = rows.columns["corners"]
    corners = corners.astype(np.int64)
    check_corners(corners, counts, vertices, lambda face: f"face {face}")
    triangles, notes = triangulated(in_space(points), corners, counts, limits)
    return ParsedMesh(in_space(points), triangles, notes + left_over(len(data) - rows.end, "byte"))


def write(vertices: Floats, faces: Ints, colours: Floats | None, _uv: Floats | None) -> bytes:
    """Return an off file. With `colours` it is a COFF file, with red, green, blue and alpha from 0 to 255."""
    header = f"{'OFF' if colours is None else 'COFF'}\n{len(vertices)} {len(faces)} 0\n"
    if colours is None:
        rows = lines_of("", vertices)
    else:
        words = [" ".join(map(str, row)) for row in np.rint(255 * colours).astype(int).tolist()]
        places = zip(vertices.tolist(), words, strict=True)
        rows = "".join(f"{x!r} {y!r} {z!r} {word} 255\n" for (x, y, z), word in places)
    return (header + rows + lines_of("3", faces)).encode()


OFF: Final = MeshFormat("off", recognises, announced, read, write)
