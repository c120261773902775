"""What off, obj and stl files need before trimesh reads them, and where such a file is wrong."""

from __future__ import annotations

import re
from collections.abc import Iterator

from unbend.errors import MeshReadError
from unbend.mesh.formats.detect import is_binary_stl

_WITHOUT_SLASH = re.compile(rb"/[^\s]*")
_VERTEX_FIELDS = 3
_SOLID = re.compile(rb"^[^\S\n]*(end)?solid\b[^\n]*\n?", re.MULTILINE | re.IGNORECASE)


def bare_obj(data: bytes) -> bytes:
    """Return an obj file with only positions and faces.

    trimesh makes a copy of a vertex for every texture coordinate or normal it is used with, and one mesh for
    every material; without those, vertices stay as they are numbered in the file.
    """
    lines: list[bytes] = []
    vertices, largest, where = 0, 0, 0
    for number, line in _obj_lines(data):
        words = line.split()
        if words[0] == b"v":
            vertices += 1
            lines.append(b" ".join(_numbers(words[1 : 1 + _VERTEX_FIELDS], number, line, prefix=b"v")))
        elif words[0] == b"f":
            corners = [_corner(word, vertices, number) for word in words[1:]]
            if len(corners) < 3:
                raise MeshReadError(f"line {number}: a face with {len(corners)} corners")
            lines.append(b"f " + b" ".join(map(b"%d".__mod__, corners)))
            if max(corners) > largest:
                largest, where = max(corners), number
    if largest > vertices:
        raise MeshReadError(f"line {where}: a face with vertex {largest}, but there are {vertices}")
    return b"\n".join(lines) + b"\n"


def one_solid(data: bytes) -> bytes:
    """Return a text stl file with one solid, for trimesh makes a mesh of each; a binary one as it is.

    Raises
    ------
    MeshReadError
        If a solid does not end.
    """
    if is_binary_stl(data):
        return data
    ends = [bool(word) for word in _SOLID.findall(data)]
    if not ends or ends != [False, True] * (len(ends) // 2):
        raise MeshReadError("a solid of the stl file does not begin or does not end")
    return b"solid\n" + _SOLID.sub(b"", data) + b"\nendsolid\n"


def check_off(data: bytes) -> None:
    """Say where an off file is damaged; trimesh takes a file that ends early for a smaller mesh.

    Raises
    ------
    MeshReadError
        If the counts are missing, or lines are missing or are not the numbers they should be.
    """
    lines = _off_lines(data)
    number, counts = next(lines, (1, b""))
    try:
        vertices, faces = (int(word) for word in counts.split()[:2])
    except ValueError:
        raise MeshReadError(f"line {number}: the counts of vertices and faces are missing") from None
    if vertices < 0 or faces < 0:
        raise MeshReadError(f"line {number}: a count is negative")
    found = 0
    for found, (number, line) in enumerate(lines, start=1):
        if found <= vertices:
            _numbers(line.split()[:_VERTEX_FIELDS], number, line)
        elif found <= vertices + faces:
            _check_off_face(line, number, vertices)
        else:
            break
    if found < vertices + faces:
        missing = f"{vertices} vertices and {faces} faces announced, {found} lines found"
        raise MeshReadError(f"line {number}: the file ends early: {missing}")


def _obj_lines(data: bytes) -> Iterator[tuple[int, bytes]]:
    for number, line in enumerate(data.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines(), start=1):
        if line[:2] in (b"v ", b"v\t", b"f ", b"f\t") or (line[:1] in b" \t" and line.split()[:1] in ([b"v"], [b"f"])):
            yield number, line


def _off_lines(data: bytes) -> Iterator[tuple[int, bytes]]:
    header_seen = False
    for number, raw in enumerate(data.splitlines(), start=1):
        line = raw.split(b"#")[0].strip()
        if not header_seen and line:
            header_seen = True
            line = re.sub(rb"^(ST)?C?N?OFF(\s+BINARY)?", b"", line, flags=re.IGNORECASE).strip()
        if line:
            yield number, line


def _numbers(words: list[bytes], number: int, line: bytes, prefix: bytes | None = None) -> list[bytes]:
    try:
        values = [float(word) for word in words]
    except ValueError:
        values = []
    if len(values) != _VERTEX_FIELDS:
        raise MeshReadError(f"line {number}: three coordinates expected, found {_shown(line)}")
    return words if prefix is None else [prefix, *words]


def _corner(word: bytes, vertices: int, number: int) -> int:
    try:
        index = int(_WITHOUT_SLASH.sub(b"", word))
    except ValueError:
        raise MeshReadError(f"line {number}: {_shown(word)} is not a vertex of a face") from None
    index = index if index > 0 else vertices + 1 + index  # negative ones count back from the last vertex
    if index < 1:
        raise MeshReadError(f"line {number}: {_shown(word)} is before the first vertex")
    return index


def _check_off_face(line: bytes, number: int, vertices: int) -> None:
    try:
        count, *corners = (int(word) for word in _face_words(line))
    except ValueError:
        raise MeshReadError(f"line {number}: a face expected, found {_shown(line)}") from None
    if count < 3 or len(corners) < count:
        raise MeshReadError(f"line {number}: a face with {min(count, len(corners))} of {count} corners")
    if min(corners) < 0 or max(corners) >= vertices:
        raise MeshReadError(f"line {number}: a face outside the {vertices} vertices, in {_shown(line)}")


def _face_words(line: bytes) -> list[bytes]:
    words = line.split()
    return words[: int(words[0]) + 1]  # colours may follow


def _shown(text: bytes) -> str:
    return repr(text[:40].decode("utf-8", "replace"))
