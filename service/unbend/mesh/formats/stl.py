"""stl files, binary or text: facets that share no corners.

A binary file is recognised by its length, whatever its header begins with: 84 bytes, and 50 for each facet that the
header announces. It may also be longer, if its first facets have plausible coordinates. Bytes after the last facet are
skipped. In text, several keywords may share a line. The name of a solid ends at the end of its line, or before `facet
normal`.
"""

from __future__ import annotations

import itertools
import re
import struct
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from unbend.arrays import Floats, Indices
from unbend.errors import MeshReadError
from unbend.mesh.formats.parsed import MeshFormat, ParsedMesh, left_over
from unbend.mesh.formats.polygons import triangulated
from unbend.mesh.formats.text import MARK, plain, shown, table, without_comments
from unbend.mesh.limits import MeshLimits
from unbend.mesh.report import counted_noun

_HEAD: Final = 2**16  # bytes that are searched for the first facet of a text file
_HEADER: Final = 84
_FACET: Final = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_LOOKED_AT: Final = 100  # facets that are checked if bytes follow the last facet
_SIZES: Final = 1e-30, 1e30  # numbers outside this range do not count as coordinates
_TEXT: Final = re.compile(rb"(?:%b)?\s*(?:solid\b|facet\s)" % MARK, re.IGNORECASE)
_SOLID: Final = re.compile(rb"\b(end[ \t]*)?solid\b(?:(?!\bfacet\s{1,9}normal\b)[^\n])*")
_KEYWORD: Final = re.compile(rb"(?<=\S)(?<!end)[ \t]+(facet|outer|vertex|endloop|endfacet|end)\b")
_CONTROL: Final = re.compile(rb"[\x00-\x08\x0e-\x19\x1b-\x1f]")  # characters that no text has
_BREAK: Final = re.compile(rb"[\n\v]")
_BEGINS: Final = (b"facet", b"outer")
_BOUNDS: Final = (*_BEGINS, b"end")
_WORDS: Final = (*_BOUNDS, b"vertex", b"color")


def recognises(data: bytes) -> bool:
    """Return whether a file is long enough for a binary stl file and looks like one, or begins like a text one."""
    return _binary(data) or _text(data)


def _binary(data: bytes) -> bool:
    facets = _announced_facets(data)
    length = _HEADER + _FACET.itemsize * facets
    return facets > 0 and (len(data) == length or (len(data) > length and _plausible(data, facets)))


def _announced_facets(data: bytes) -> int:
    return int(struct.unpack_from("<I", data, _HEADER - 4)[0]) if len(data) >= _HEADER else 0


def _plausible(data: bytes, facets: int) -> bool:
    """Return whether the first facets have coordinates of a usual size, unlike random bytes."""
    found: Any = np.abs(np.frombuffer(data, _FACET, min(facets, _LOOKED_AT), _HEADER)["corners"])
    sound = (found == 0) | ((found > _SIZES[0]) & (found < _SIZES[1]))
    return bool(sound.all() and found.any())


def _text(data: bytes) -> bool:
    head = data[:_HEAD]
    return bool(_TEXT.match(head)) and re.search(rb"facet|endsolid|end solid", head, re.IGNORECASE) is not None


def announced(data: bytes) -> tuple[int, int]:
    """Return 0 for the number of vertices, which is unknown until equal corners are merged, and the number of facets.

    A binary file announces this number. In text, the ends of facets are counted.
    """
    if _text(data) and not _binary(data):
        return 0, data.count(b"endfacet") + data.count(b"ENDFACET")
    return 0, _announced_facets(data)


def read(data: bytes, limits: MeshLimits) -> ParsedMesh:
    """Return the facets of an stl file. Each corner is a vertex, in the order of the file."""
    if _text(data) and not _binary(data):
        return _read_text(data, limits)
    if len(data) < _HEADER:
        what = f"too short for a binary file: {len(data)} bytes, while the header alone has {_HEADER}"
        raise MeshReadError(f"the stl file does not begin with a solid or a facet, and is {what}")
    if not _CONTROL.search(data, 0, _HEAD):
        raise MeshReadError("the stl file is text, but does not begin with a facet or with a solid that has one")
    announced_, there = _announced_facets(data), (len(data) - _HEADER) // _FACET.itemsize
    if announced_ > there or (there and not announced_):
        raise MeshReadError(f"the stl file announces {announced_:,} facets, but has {there:,}")
    facets: Any = np.frombuffer(data, _FACET, announced_, _HEADER)
    vertices = facets["corners"].astype(np.float64).reshape(-1, 3)
    behind = len(data) - _HEADER - announced_ * _FACET.itemsize
    return ParsedMesh(vertices, np.arange(len(vertices)).reshape(-1, 3), left_over(behind, "byte"))


def _read_text(data: bytes, limits: MeshLimits) -> ParsedMesh:
    text = without_comments(plain(data)).lower()
    ends = [bool(found) for found in _SOLID.findall(text)]
    # A vertical tab begins a line at each keyword, so that newlines still count the lines of the file.
    text = _KEYWORD.sub(rb"\v\1", _SOLID.sub(b"", text))
    lines = [line.strip() for line in text.replace(b"\v", b"\n").split(b"\n")]

    def place(line: int) -> str:
        breaks = itertools.islice(_BREAK.finditer(text), line)
        above = sum(found[0] == b"\n" for found in breaks)
        return f"line {above + 1}"

    at = np.flatnonzero([line.startswith(b"vertex") for line in lines])
    vertices = _vertices([lines[number] for number in at], lambda index: place(int(at[index])))
    counts = _corners(lines, at, place)
    faces, notes = triangulated(vertices, np.arange(len(vertices)), counts, limits)
    many = int((counts > 3).sum())
    if many:
        notes += (f"{counted_noun(many, 'facet', 'facets')} of more than three corners cut into triangles",)
    return ParsedMesh(vertices, faces, notes + _notes(lines, ends))


def _vertices(lines: list[bytes], place: Callable[[int], str]) -> Floats:
    rows = table(b"\n".join([*(line[6:] for line in lines), b""]))
    wrong = np.flatnonzero(rows.widths != 3)[:1].tolist() or ([] if rows.broken is None else [rows.broken])
    if wrong:
        raise MeshReadError(f"{place(wrong[0])}: three coordinates expected, found {shown(lines[wrong[0]])}")
    return rows.values.reshape(-1, 3)


def _corners(lines: list[bytes], at: Indices, place: Callable[[int], str]) -> Indices:
    """Return the number of corners of each facet, or of each loop of a facet; `at` are the lines of vertices."""
    bounds = np.flatnonzero([line.startswith(_BOUNDS) for line in lines])
    begins = np.array([lines[number].startswith(_BEGINS) for number in bounds], bool)
    facets = np.array([lines[number].startswith(b"facet") for number in bounds], bool)
    behind = np.searchsorted(bounds, at) - 1  # the boundary above each vertex
    outside = np.flatnonzero((behind < 0) | ~np.append(begins, False)[behind])
    if len(outside):
        raise MeshReadError(f"{place(int(at[outside[0]]))}: a vertex is outside a facet")
    counts = np.bincount(behind, minlength=len(bounds))
    has_loops = facets & np.append(begins[1:] & ~facets[1:], False) & (counts == 0)
    few = np.flatnonzero(begins & ~has_loops & (counts < 3))
    if len(few):
        what = f"a facet has only {counts[few[0]]} of three corners"
        raise MeshReadError(f"{place(int(bounds[few[0]]))}: {what}")
    sizes: Indices = counts[begins & ~has_loops]
    return sizes


def _notes(lines: list[bytes], ends: list[bool]) -> tuple[str, ...]:
    notes = []
    unknown = sum(1 for line in lines if line and not line.startswith(_WORDS))
    if unknown:
        notes.append(f"{counted_noun(unknown, 'unknown line', 'unknown lines')} skipped")
    if ends != [False, True] * (len(ends) // 2):
        notes.append("a solid of the stl file has no beginning or no end, but every facet is complete")
    return tuple(notes)


STL: Final = MeshFormat("stl", recognises, announced, read)
