"""ply files: positions, polygons and strips of triangles. Every other element and property is skipped.

Text is converted to binary rows in which every number is a double. In most text files each row has its own line; in
others the line breaks have no meaning. In a file with one row per line, an additional number would shift all later
rows, so such a line is an error.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from unbend.arrays import Floats, Indices, Ints
from unbend.errors import MeshReadError
from unbend.mesh.formats.corners import check_corners, whole
from unbend.mesh.formats.parsed import MeshFormat, ParsedMesh, left_over
from unbend.mesh.formats.ply_header import HEADER, MAGIC, Element, Header, read_header
from unbend.mesh.formats.polygons import triangulated
from unbend.mesh.formats.records import Column, Rows, read_rows
from unbend.mesh.formats.strips import strip_faces
from unbend.mesh.formats.text import Table, plain, shown, table
from unbend.mesh.limits import MeshLimits

_COUNTS: Final = re.compile(rb"^element[ \t]+(vertex|face)[ \t]+(\d{1,18})[ \t]*\r?$", re.MULTILINE | re.IGNORECASE)
_COMMENTS: Final = re.compile(rb"^[ \t]*(?:comment|obj_info|#)[^\n]*", re.MULTILINE)
_TRIANGLES: Final = ("face", "tristrips")  # elements
_CORNERS: Final = ("vertex_indices", "vertex_index")


def recognises(data: bytes) -> bool:
    """Return whether a file begins with the word ply on its own line."""
    return bool(MAGIC.match(data[:64]))


def announced(data: bytes) -> tuple[int, int]:
    """Return the numbers of vertices and faces that the header announces."""
    header = data[:HEADER].partition(b"end_header")[0].replace(b"\r", b"\n")
    counts = {name.lower(): int(count) for name, count in _COUNTS.findall(header)}
    return counts.get(b"vertex", 0), counts.get(b"face", 0)


def read(data: bytes, limits: MeshLimits) -> ParsedMesh:
    """Return the mesh of a ply file."""
    header = read_header(data)
    places = {field.name for element in header.elements if element.name == "vertex" for field in element.fields}
    if missing := sorted({"x", "y", "z"} - places):
        raise MeshReadError(f"the vertices of the ply file have no {missing[0]}")
    corners_of = {element.name: _corners_of(element) for element in header.elements if element.name in _TRIANGLES}
    if not corners_of:
        raise MeshReadError("the ply file contains no triangles: it has neither faces nor strips")
    rows, notes = _text_rows(data, header) if header.text else _binary_rows(data, header)
    vertices = _vertices(rows)
    limits.check(len(vertices), 0)
    faces = [np.empty((0, 3), np.int64)]
    for name, corners_name in corners_of.items():
        column = rows[name].columns[corners_name]
        if name == "face":
            polygons, more = triangulated(vertices, *_corners(column, len(vertices)), limits)
            faces.append(polygons)
            notes += more
        else:
            faces.append(_strips(column, len(vertices), limits))
    return ParsedMesh(vertices, np.concatenate(faces), header.notes + notes)


def _binary_rows(data: bytes, header: Header) -> tuple[dict[str, Rows], tuple[str, ...]]:
    rows, position = _read_elements(data, header.end, header.elements)
    behind = data[position:]
    return rows, left_over(len(behind) if behind.strip(b"\0 \t\r\n") else 0, "byte")


def _read_elements(body: bytes, position: int, elements: tuple[Element, ...]) -> tuple[dict[str, Rows], int]:
    rows = {}
    for element in elements:
        try:
            rows[element.name] = read_rows(body, position, element.length, element.fields)
        except MeshReadError as error:
            raise MeshReadError(f"element {shown(element.name)} of the ply file: {error}") from None
        position = rows[element.name].end
    return rows, position


def _text_rows(data: bytes, header: Header) -> tuple[dict[str, Rows], tuple[str, ...]]:
    text = plain(data[header.end :])
    text = _COMMENTS.sub(b"", text) if b"comment" in text or b"obj_info" in text or b"#" in text else text
    numbers, lines = table(text), text.split(b"\n")
    try:
        rows, end = _read_elements(numbers.values.tobytes(), 0, header.elements)
    except MeshReadError:
        _check_line(numbers, lines, header, _misfit(numbers, header.elements))
        raise
    starts = 8 * numbers.starts[numbers.widths > 0]
    behind = int((starts >= end).sum())
    behind += 0 if numbers.broken is None else sum(1 for line in lines[numbers.broken :] if line.strip())
    begins = np.concatenate([found.begins for found in rows.values()])
    if len(begins) == len(starts) - int((starts >= end).sum()) or behind:  # otherwise line breaks have no meaning
        within = np.flatnonzero(~np.isin(np.append(begins, end), np.append(starts, 8 * len(numbers.values))))
        if len(within):
            line = int(np.searchsorted(8 * numbers.starts, np.append(begins, end)[within[0]])) - 1
            wrong = _misfit(numbers, header.elements)
            _check_line(numbers, lines, header, line if wrong is None else wrong)
    return rows, left_over(behind, "line")


def _misfit(numbers: Table, elements: tuple[Element, ...]) -> int | None:
    """Return the first line whose number of values is not the number of fields of its element, None if there is none.

    The search stops at the first element with lists.
    """
    filled = np.flatnonzero(numbers.widths)
    begin = 0
    for element in itertools.takewhile(lambda element: not any(field.counter for field in element.fields), elements):
        rows = filled[begin : begin + element.length]
        wrong = rows[numbers.widths[rows] != len(element.fields)]
        if len(wrong):
            return int(wrong[0])
        begin += element.length
    return None


def _check_line(numbers: Table, lines: list[bytes], header: Header, wrong: int | None) -> None:
    """Raise MeshReadError about the line `wrong`, or, if it is None, about the first line that is not numbers."""
    at = numbers.broken if wrong is None else wrong
    if at is None:
        return
    what = "numbers expected" if wrong is None else f"{numbers.widths[at]} numbers, not as many as the header says"
    raise MeshReadError(f"line {header.lines + at + 1}: {what}, found {shown(lines[at])}")


def _vertices(rows: dict[str, Rows]) -> Floats:
    columns: dict[str, Column] = rows["vertex"].columns
    axes: list[Any] = [columns[axis][0] for axis in "xyz"]
    if len({len(values) for values in axes}) > 1 or len(axes[0]) != len(columns["x"][1]):
        raise MeshReadError("the coordinates of the ply file are lists, not single numbers")
    return np.stack(axes, axis=1).astype(np.float64)


def _corners_of(element: Element) -> str:
    """Return the name of the property with the corners: the property with a known name, or the only list."""
    names = [field.name for field in element.fields]
    lists = [field.name for field in element.fields if field.counter]
    found = [name for name in _CORNERS if name in names] or lists[: len(lists) == 1]
    if not found:
        raise MeshReadError(f"the {element.name} element of the ply file has no {_CORNERS[0]}")
    return found[0]


def _corners(column: Column, vertices: int) -> tuple[Indices, Indices]:
    values, counts = column
    corners = whole(values, counts, "face {} of the ply file".format)
    check_corners(corners, counts, vertices, "face {} of the ply file".format)
    return corners, counts


def _strips(column: Column, vertices: int, limits: MeshLimits) -> Indices:
    """Return the triangles of strips, which are separated by -1."""
    values, counts = column
    ends = np.cumsum(counts)
    corners = np.insert(whole(values, counts, "strip {} of the ply file".format), ends, -1)
    limits.check(vertices, int(np.maximum(np.diff(np.flatnonzero(np.append(-1, corners) == -1)) - 3, 0).sum()))
    kept = np.where(corners == -1, 0, corners)
    check_corners(kept, counts + 1, max(vertices, 1), "strip {} of the ply file".format)
    return strip_faces(corners, corners == -1)


def write(vertices: Floats, faces: Ints, colours: Floats | None, _uv: Floats | None) -> bytes:
    """Return a binary ply file of single precision. It stores `colours` as red, green, blue and alpha, 0 to 255."""
    names = ["red", "green", "blue", "alpha"] if colours is not None else []
    points = np.empty(len(vertices), [("place", "<f4", 3)] + [("colour", "u1", 4)] * bool(names))
    points["place"] = vertices
    if colours is not None:
        points["colour"] = 255
        points["colour"][:, :3] = np.rint(255 * colours)
    properties = [f"property float {axis}" for axis in "xyz"] + [f"property uchar {name}" for name in names]
    return _file(properties, points, faces)


def write_exactly(vertices: Floats, faces: Indices) -> bytes:
    """Return a binary ply file of double precision, which loses nothing."""
    return _file([f"property double {axis}" for axis in "xyz"], np.asarray(vertices, "<f8"), faces)


def _file(properties: Sequence[str], points: NDArray[Any], faces: Ints | Indices) -> bytes:
    polygons = np.empty(len(faces), [("count", "u1"), ("corners", "<i4", 3)])
    polygons["count"], polygons["corners"] = 3, faces
    lines = [
        "ply", "format binary_little_endian 1.0", f"element vertex {len(points)}", *properties,
        f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header", "",
    ]  # fmt: skip
    return "\n".join(lines).encode() + points.tobytes() + polygons.tobytes()


PLY: Final = MeshFormat("ply", recognises, announced, read, write)
