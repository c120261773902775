"""The header of a ply file: the elements, their numbers of rows, and the fields of a row."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final, NoReturn

from unbend.errors import MeshReadError
from unbend.mesh.formats.records import Field
from unbend.mesh.formats.text import MARK, shown

HEADER: Final = 2**16
"""Bytes that are searched for the announced counts before a file is read."""

MAGIC: Final = re.compile(rb"(?:%b)?ply[ \t]*(\r\n|\n|\r)" % MARK, re.IGNORECASE)
_END: Final = re.compile(rb"[\r\n]end_header[ \t]*(\r\n|\n|\r|$)", re.IGNORECASE)
_LINE_END: Final = re.compile(r"\r\n|\r|\n")
_TYPES: Final = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8", "int64": "i8", "uint64": "u8",
}  # fmt: skip
_ORDERS: Final = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True)
class Element:
    """A table of rows with the same fields."""

    name: str
    length: int
    fields: tuple[Field, ...]


@dataclass(frozen=True)
class Header:
    """The elements that a header announces, and where it ends."""

    text: bool
    elements: tuple[Element, ...]
    end: int
    """Number of bytes of the header."""
    lines: int
    """Number of lines of the header."""
    notes: tuple[str, ...]


def read_header(data: bytes) -> Header:
    """Return the header of a ply file. The case of its letters does not matter.

    Raises
    ------
    MeshReadError
        If the header does not end, names no format, or has an invalid format, element or property line.
    """
    end, first = _END.search(data), MAGIC.match(data)
    if not end or not first:
        raise MeshReadError("the header of the ply file does not " + ("end" if first else "begin"))
    alone = first.group(1) == b"\r"  # then a newline after the header is the first byte of a row
    text = data[first.end() : end.start()].decode("utf-8", "replace").lower()
    order, name = "", ""
    lengths, fields, unknown = dict[str, int](), dict[str, list[Field]](), list[str]()
    lines = _LINE_END.split(text)
    for number, line in enumerate(lines, start=2):
        match line.split():
            case ["format", word, *_] if word in _ORDERS:
                order = word
            case ["element", name, count] if count.isdecimal() and len(count) < 19 and name not in lengths:
                lengths[name], fields[name] = int(count), []
            case ["property", *words] if name:
                fields[name].append(_field(words, order, number))
            case ["format" | "element" | "property", *_]:
                _refuse(number, line)
            case ["comment" | "obj_info", *_] | []:
                pass
            case _:
                unknown.append(line)
    if not order:
        raise MeshReadError("the header of the ply file names no format")
    elements = tuple(Element(name, length, tuple(fields[name])) for name, length in lengths.items())
    behind = end.start(1) + (1 if alone else len(end.group(1)))
    notes = (f"lines of the header skipped, the first {shown(unknown[0])}",) if unknown else ()
    return Header(order == "ascii", elements, behind, len(lines) + 2, notes)


def _field(words: list[str], order: str, number: int) -> Field:
    is_list = words[:1] == ["list"]
    kinds = words[1 if is_list else 0 : -1]
    if not order:
        raise MeshReadError(f"line {number}: the header of the ply file names no format before its properties")
    if len(kinds) != (2 if is_list else 1) or any(kind not in _TYPES for kind in kinds):
        _refuse(number, "property " + " ".join(words))
    found = [_ORDERS[order] + ("f8" if order == "ascii" else _TYPES[kind]) for kind in kinds]
    return Field(words[-1], found[-1], found[0] if is_list else "")


def _refuse(number: int, line: str) -> NoReturn:
    raise MeshReadError(f"line {number}: {shown(line)} is not valid in the header of a ply file")
