"""How much a file says it holds, found at the speed of a search and before anything is kept of it.

What is announced may be a lie, and for some files nothing is found: who reads them counts again.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from typing import Final

_HEADER: Final = 2**16  # bytes that a header may have; one that is longer announces nothing
_BLANK: Final = rb"(?:\s|#[^\n]*\n)"
_OFF: Final = re.compile(rb"%b*(?:ST)?C?N?OFF%b+(\d{1,18})\s+(\d{1,18})\b" % (_BLANK, _BLANK), re.IGNORECASE)
_PLY: Final = re.compile(rb"^element[ \t]+(vertex|face)[ \t]+(\d{1,18})[ \t]*\r?$", re.MULTILINE)


def announced(data: bytes, kind: str) -> tuple[int, int]:
    """Return how many vertices and faces a file of format `kind` announces, or has lines for; 0 where unknown.

    Faces are polygons where the format has them, so there may be more triangles. Vertices of stl are not known
    before equal ones are merged.
    """
    return _ANNOUNCED[kind](data) if kind in _ANNOUNCED else (0, 0)


def _off(data: bytes) -> tuple[int, int]:
    found = _OFF.match(data[:_HEADER])
    return (int(found.group(1)), int(found.group(2))) if found else (0, 0)


def _obj(data: bytes) -> tuple[int, int]:
    return data.count(b"\nv "), data.count(b"\nf ")  # less one, at most, and those that are indented


def _ply(data: bytes) -> tuple[int, int]:
    header = data[:_HEADER].partition(b"end_header")[0]
    counts = {name: int(count) for name, count in _PLY.findall(header)}
    return counts.get(b"vertex", 0), counts.get(b"face", 0)


def _stl(data: bytes) -> tuple[int, int]:
    if data[:_HEADER].lstrip().lower().startswith(b"solid") and b"facet" in data[:_HEADER].lower():
        return 0, data.count(b"endfacet") + data.count(b"ENDFACET")
    return 0, struct.unpack_from("<I", data, 80)[0] if len(data) > 84 else 0


_ANNOUNCED: Final[dict[str, Callable[[bytes], tuple[int, int]]]] = {"off": _off, "obj": _obj, "ply": _ply, "stl": _stl}
