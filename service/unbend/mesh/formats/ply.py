"""ply files: positions and faces; every other element and property is stepped over.

Read here and not by trimesh, which takes all rows of a binary element to be as long as the first, so that triangles
beside quads are refused or come out wrong, and a file of text that ends early for a smaller mesh.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from typing import Any, Final, NoReturn

import numpy as np

from unbend.arrays import Floats, Indices
from unbend.errors import MeshReadError

_TYPES: Final = {
    "char": "b", "int8": "b", "uchar": "B", "uint8": "B", "short": "h", "int16": "h", "ushort": "H", "uint16": "H",
    "int": "i", "int32": "i", "uint": "I", "uint32": "I", "float": "f", "float32": "f", "double": "d", "float64": "d",
}  # fmt: skip
_ORDERS: Final = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}
_END: Final = re.compile(rb"^end_header[ \t]*(\r\n|\n|\r|$)", re.MULTILINE)
_CORNERS: Final = ("vertex_indices", "vertex_index")
_MOST: Final = 2**31  # corners of a face

Column = tuple[Any, Any]
"""Values of all rows, one after the other, and how many each row has."""


@dataclass(frozen=True)
class _Property:
    name: str
    kind: str
    """As `struct` and NumPy call it."""
    counter: struct.Struct | None
    """Of a list: what precedes its values."""

    @property
    def width(self) -> int:
        return struct.calcsize(self.kind)


@dataclass(frozen=True)
class _Element:
    name: str
    length: int
    properties: tuple[_Property, ...]


def read_ply(data: bytes) -> tuple[Floats, Indices]:
    """Return vertices (n, 3) and faces (m, 3), polygons cut into triangles.

    Raises
    ------
    MeshReadError
        If the file is damaged, ends early, or goes on behind its last element.
    """
    text, elements, body = _split(data)
    if text:  # as if it were binary, with every number a double
        body = np.fromstring(body, np.float64, sep=" ").astype("<f8").tobytes()
    position, vertices, faces = 0, np.empty((0, 3)), np.empty((0, 3), np.int64)
    for element in elements:
        columns, position = _columns(body, position, element)
        if element.name == "vertex":
            vertices = np.stack([columns[axis][0] for axis in "xyz"], axis=1).astype(np.float64)
        elif element.name == "face":
            faces = _triangles(*columns[_corners_of(element)])
    if body[position:].strip(b"\0 \t\r\n"):
        raise MeshReadError(f"the ply file goes on behind its last element, for {len(body) - position} bytes")
    return vertices, faces


def _split(data: bytes) -> tuple[bool, list[_Element], bytes]:
    """Return whether the file is text, its elements, and what follows the header."""
    end = _END.search(data)
    if not end:
        raise MeshReadError("the header of the ply file does not end")
    order, name = "", ""
    lengths, properties = dict[str, int](), dict[str, list[_Property]]()
    for number, line in enumerate(data[: end.start()].decode("utf-8", "replace").splitlines(), start=1):
        match line.split():
            case ["format", word, *_] if word in _ORDERS:
                order = word
            case ["element", name, count] if count.isdecimal() and len(count) < 19 and name not in lengths:
                lengths[name], properties[name] = int(count), []
            case ["property", *words] if name:
                properties[name].append(_property(words, order, number))
            case ["ply" | "comment" | "obj_info", *_] | []:
                pass
            case _:
                _refuse(number, line)
    if not order:
        raise MeshReadError("the header of the ply file names no format")
    elements = [_Element(name, length, tuple(properties[name])) for name, length in lengths.items()]
    return order == "ascii", elements, data[end.end() :]


def _property(words: list[str], order: str, number: int) -> _Property:
    if not order or any(word not in _TYPES for word in words[1 if words[:1] == ["list"] else 0 : -1]):
        _refuse(number, " ".join(words))
    kinds = [_ORDERS[order] + ("d" if order == "ascii" else _TYPES[word]) for word in words[:-1] if word != "list"]
    if len(kinds) != (2 if words[0] == "list" else 1):
        _refuse(number, " ".join(words))
    return _Property(words[-1], kinds[-1], struct.Struct(kinds[0]) if words[0] == "list" else None)


def _refuse(number: int, line: str) -> NoReturn:
    raise MeshReadError(f"line {number}: {line[:40]!r} means nothing in the header of a ply file")


def _columns(body: bytes, start: int, element: _Element) -> tuple[dict[str, Column], int]:
    """Return an element's properties by name, and where it ends."""
    if element.length == 0 or not element.properties:
        empty = np.empty(0), np.empty(0, np.int64)
        return {item.name: empty for item in element.properties}, start
    return _alike(body, start, element) or _one_by_one(body, start, element)


def _alike(body: bytes, start: int, element: _Element) -> tuple[dict[str, Column], int] | None:
    """Read an element all rows of which have lists as long as the first row's; None if they have not."""
    places, position = [], start
    for item in element.properties:
        count = 1
        if item.counter:
            count = _count(body, position, item.counter)
            position += item.counter.size
        places.append((position, count))
        position += count * item.width
    row, length = position - start, element.length
    if start + row * length > len(body):
        return None
    columns = {}
    for item, (place, count) in zip(element.properties, places, strict=True):
        if item.counter:
            counter = item.counter.format
            counts: Any = np.ndarray((length,), counter, body, place - item.counter.size, (row,))
            if (counts != count).any():
                return None
        values: Any = np.ndarray((length, count), item.kind, body, place, (row, item.width))
        columns[item.name] = values.ravel(), np.full(length, count)
    return columns, start + row * length


def _one_by_one(body: bytes, start: int, element: _Element) -> tuple[dict[str, Column], int]:
    places: list[list[int]] = [[] for _ in element.properties]
    counts: list[list[int]] = [[] for _ in element.properties]
    position = start
    for _ in range(element.length):
        for number, item in enumerate(element.properties):
            count = 1
            if item.counter:
                count = _count(body, position, item.counter)
                position += item.counter.size
            places[number].append(position)
            counts[number].append(count)
            position += count * item.width
        if position > len(body):
            _early()
    columns = {
        item.name: _gathered(body, item, np.array(places[number]), np.array(counts[number]))
        for number, item in enumerate(element.properties)
    }
    return columns, position


def _count(body: bytes, position: int, counter: struct.Struct) -> int:
    if position + counter.size > len(body):
        _early()
    count = counter.unpack_from(body, position)[0]
    if not (0 <= count < _MOST and count == int(count)):
        raise MeshReadError(f"a list of {count} values in the ply file")
    return int(count)


def _early() -> NoReturn:
    raise MeshReadError("the ply file ends early: rows that its header announces are missing")


def _gathered(body: bytes, item: _Property, places: Indices, counts: Indices) -> Column:
    """Return the values at some places in the body, as many as each has."""
    found = np.empty(int(counts.sum()), item.kind)
    firsts = np.cumsum(counts) - counts
    raw = np.frombuffer(body, np.uint8)
    for count in np.unique(counts[counts > 0]):
        rows = counts == count
        cells = raw[places[rows, None] + np.arange(count * item.width)]
        found[firsts[rows, None] + np.arange(count)] = np.ascontiguousarray(cells).view(item.kind)
    return found, counts


def _corners_of(element: _Element) -> str:
    """Return the property that holds the corners of faces: by its name, or the only one."""
    names = [item.name for item in element.properties]
    found = [name for name in _CORNERS if name in names] or names[: len(names) == 1]
    if not found:
        raise MeshReadError(f"the faces of the ply file have no {_CORNERS[0]}")
    return found[0]


def _triangles(corners: Any, counts: Indices) -> Indices:
    """Cut polygons, as fans around their first corners, into triangles."""
    if corners.dtype.kind == "f" and not (np.floor(corners) == corners).all():
        raise MeshReadError("a corner of a face in the ply file is no whole number")
    if len(corners) and not (abs(corners.astype(np.float64)) < 2.0**62).all():
        raise MeshReadError("a corner of a face in the ply file is no vertex")
    if (counts < 3).any():
        row = int(np.flatnonzero(counts < 3)[0])
        raise MeshReadError(f"face {row} of the ply file has {counts[row]} corners")
    corners = corners.astype(np.int64)
    each = counts - 2
    polygon = np.repeat(np.cumsum(counts) - counts, each)
    step = np.arange(len(polygon)) - np.repeat(np.cumsum(each) - each, each)
    return np.stack([corners[polygon], corners[polygon + step + 1], corners[polygon + step + 2]], axis=1)
