"""Wavefront obj files: positions and polygons. Texture coordinates, normals, groups and materials are skipped.

Lines are sorted by their first word, and all lines of one kind are read at once. A comment ends with its line, even if
the line ends in a backslash. Any other backslash at the end of a line joins the next line to it, unless the next line
begins a vertex or a face: the backslash is then part of a path. Positive corners count vertices from 1. Negative
corners count backwards from the last vertex above the face.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np

from unbend.arrays import Floats, Indices, Ints
from unbend.errors import MeshReadError
from unbend.mesh.formats.corners import whole
from unbend.mesh.formats.parsed import MeshFormat, ParsedMesh, words_cut
from unbend.mesh.formats.polygons import triangulated
from unbend.mesh.formats.text import MARK, Table, leading_numbers, lines_of, plain, shown, table, without_comments
from unbend.mesh.limits import MeshLimits

_LOOKED_AT: Final = 2**20  # bytes that are searched for a first vertex or face
_FIRST: Final = re.compile(rb"(?:^|[\r\n]|%b)[ \t]*[vf][ \t]+[-+.\d]" % MARK, re.IGNORECASE)  # in linear time
_CONTINUED: Final = re.compile(rb"\\[ \t]*\n(?![ \t]*(?:v[nt]?|f)[ \t]+[-+.\d])", re.IGNORECASE)
_INDENTED: Final = re.compile(rb"^[ \t\v\f]", re.MULTILINE)
_AFTER_SLASH: Final = re.compile(rb"/\S*")
_BEFORE_SLASH_NOTHING: Final = re.compile(rb"(?:^|\s)/")
_POINT: Final = frozenset((b"v", b"v ", b"v\t", b"V", b"V ", b"V\t"))
_FACE: Final = frozenset((b"f", b"f ", b"f\t", b"F", b"F ", b"F\t"))
_OUTLINE: Final = frozenset((b"fo ", b"fo\t", b"FO ", b"FO\t"))  # early versions of the format have fo instead of f
_COMMON: Final = frozenset((b"vt", b"vn", b"g ", b"o ", b"s ", b"l ", b"p "))
_KNOWN: Final = frozenset((
    b"vt", b"vn", b"vp", b"g", b"o", b"s", b"l", b"p", b"mg", b"usemtl", b"mtllib", b"usemap", b"maplib", b"lod",
    b"bevel", b"c_interp", b"d_interp", b"shadow_obj", b"trace_obj", b"ctech", b"stech", b"call", b"csh",
))  # fmt: skip
_SHOWN: Final = 5  # largest number of unknown words that a note names


def recognises(data: bytes) -> bool:
    """Return whether a line begins like a vertex or a face."""
    return b"\0" not in data[:4096].rstrip(b"\0") and bool(_FIRST.search(data, 0, _LOOKED_AT))


def announced(data: bytes) -> tuple[int, int]:
    """Return the numbers of lines that begin with v and f, without the first line and indented ones."""
    return data.count(b"\nv "), data.count(b"\nf ")


def read(data: bytes, limits: MeshLimits) -> ParsedMesh:
    """Return the mesh of an obj file."""
    text = without_comments(plain(data))
    lines = _Lines.of(text)
    points = [number for number, line in enumerate(lines.texts) if line[:2] in _POINT]
    polygons = [number for number, line in enumerate(lines.texts) if line[:2] in _FACE or line[:3] in _OUTLINE]
    if not points and not polygons:
        raise MeshReadError("the obj file has no line that begins with v or f, as vertices and faces do")
    limits.check(len(points), 0)
    vertices, odd = _vertices(lines, points)
    corners, counts = _corners(lines, polygons, points)
    faces, notes = triangulated(vertices, corners, counts, limits)
    return ParsedMesh(vertices, faces, odd + notes + _unknown(lines.texts))


@dataclass(frozen=True)
class _Lines:
    """The lines of a text, after lines that end in a backslash are joined with the next, and the text itself."""

    texts: list[bytes]
    whole: bytes

    @classmethod
    def of(cls, text: bytes) -> _Lines:
        joined = _joined(text)
        texts = joined.split(b"\n")
        return cls([line.lstrip() for line in texts] if _INDENTED.search(joined) else texts, text)

    def place(self, number: int) -> str:
        """Return the place of a line in the file: its number before lines are joined."""
        if b"\\" not in self.whole:
            return f"line {number + 1}"
        begin = sum(len(line) + 1 for line in _joined(self.whole).split(b"\n")[:number])
        above = self.whole.count(b"\n", 0, begin)
        return f"line {above + 1}"

    def wrong(self, number: int, what: str) -> MeshReadError:
        return MeshReadError(f"{self.place(number)}: {what}, found {shown(self.texts[number])}")


def _joined(text: bytes) -> bytes:
    """Return text with continued lines joined. Spaces replace the joints, so every other byte keeps its position."""
    return _CONTINUED.sub(lambda found: b" " * len(found[0]), text) if b"\\" in text else text


def _vertices(lines: _Lines, points: list[int]) -> tuple[Floats, tuple[str, ...]]:
    text = b"\n".join([*(lines.texts[number][1:] for number in points), b""])
    notes: tuple[str, ...] = ()
    rows = table(text)
    if rows.broken is not None:
        text, cut = leading_numbers(text)
        rows, notes = table(text), words_cut(cut)
    _check_numbers(rows, lines, points, "three coordinates expected")
    short = np.flatnonzero(rows.widths < 3)
    if len(short):
        raise lines.wrong(points[short[0]], "three coordinates expected")
    if len(rows.values) == 3 * len(points):
        return rows.values.reshape(-1, 3), notes
    return rows.values[rows.starts[:, None] + np.arange(3)], notes  # a weight or colours follow


def _corners(lines: _Lines, polygons: list[int], points: list[int]) -> tuple[Indices, Indices]:
    texts = map(lines.texts.__getitem__, polygons)
    text = b"\n".join([*(line[2 if line[:3] in _OUTLINE else 1 :] for line in texts), b""])
    if b"/" in text:
        if found := _BEFORE_SLASH_NOTHING.search(text):
            raise lines.wrong(polygons[text.count(b"\n", 0, found.end())], "a corner has no vertex")
        text = _AFTER_SLASH.sub(b"", text)
    rows = table(text, 0)
    _check_numbers(rows, lines, polygons, "indices of vertices expected")

    def where(face: int) -> str:
        return lines.place(polygons[face])

    corners = whole(rows.values, rows.widths, where)
    owner = np.repeat(np.arange(len(polygons)), rows.widths)
    above = np.searchsorted(points, polygons)[owner]
    found_ = np.where(corners > 0, corners - 1, corners + above)
    wrong = np.flatnonzero((corners == 0) | (found_ < 0) | (found_ >= len(points)))
    if len(wrong):
        at = int(wrong[0])
        raise MeshReadError(f"{where(int(owner[at]))}: {_fault(int(corners[at]), len(points))}")
    return found_, rows.widths


def _fault(corner: int, vertices: int) -> str:
    if corner == 0:
        return "a face uses vertex 0, but the first vertex of an obj file is 1"
    if corner < 0:
        return f"a face uses vertex {corner}, which is before the first vertex"
    return f"a face uses vertex {corner}, but the file has {vertices}"


def _check_numbers(rows: Table, lines: _Lines, numbers: list[int], expected: str) -> None:
    if rows.broken is not None:
        raise lines.wrong(numbers[rows.broken], expected)


def _unknown(texts: Iterable[bytes]) -> tuple[str, ...]:
    """Return a note on lines that begin with an unknown word."""
    rest = (line for line in texts if line[:2] not in _COMMON and line[:2] not in _POINT and line[:2] not in _FACE)
    words = {line.split(None, 1)[0] for line in rest if line.strip()}
    unknown = sorted(word for word in words if word.lower() not in _KNOWN and word.lower() != b"fo")
    if not unknown:
        return ()
    more = f" and {len(unknown) - _SHOWN} other words" if len(unknown) > _SHOWN else ""
    return (f"lines skipped that begin with {', '.join(shown(word[:8]) for word in unknown[:_SHOWN])}{more}",)


def write(vertices: Floats, faces: Ints, colours: Floats | None, uv: Floats | None) -> bytes:
    """Return an obj file without materials. `colours` follow the coordinates, and `uv` are in `vt` lines."""
    corners = faces + 1
    parts = [lines_of("v", vertices if colours is None else np.hstack([vertices, np.round(colours, 4)]))]
    if uv is None:
        parts.append(lines_of("f", corners))
    else:
        parts += [lines_of("vt", uv), lines_of("f", np.repeat(corners, 2, axis=1), "%d/%d")]
    return "".join(parts).encode()


OBJ: Final = MeshFormat("obj", recognises, announced, read, write)
