"""Which format some bytes are: by their content first, for a name proves nothing."""

from __future__ import annotations

import re
import struct
from typing import Final

from unbend.errors import MeshFormatError

FORMATS: Final = ("off", "obj", "ply", "stl", "glb")
"""The allow-list: single files, no archives, nothing that refers to other files."""

_OFF = re.compile(rb"^(\s|#[^\n]*\n)*(ST)?C?N?OFF\b", re.IGNORECASE)
_OBJ = re.compile(rb"^[ \t]*(v|f)[ \t]+[-+.\d]", re.MULTILINE)
_HEAD = 4096
_COMMENTS = 2**20
"""Bytes in which an obj's first vertex is looked for; what comes before are comments."""


def detect_format(data: bytes, hint: str | None = None) -> str:
    """Return the format of `data`, one of `FORMATS`.

    Parameters
    ----------
    data : bytes
        The whole file.
    hint : str, optional
        A file name's extension, used only where the content does not tell.

    Raises
    ------
    MeshFormatError
        If the content is of no known format and the hint is none either.
    """
    found = _by_content(data)
    if found:
        return found
    if hint in FORMATS:
        return hint
    what = "empty" if not data[:_COMMENTS].strip() else f"a .{hint} file" if hint else "of no format we know"
    raise MeshFormatError(f"the file is {what}; formats read are {', '.join(FORMATS)}")


def _by_content(data: bytes) -> str | None:
    head = data[:_HEAD]
    if head.startswith(b"glTF"):
        return "glb"
    if re.match(rb"ply\s", head):
        return "ply"
    if _OFF.match(head):
        return "off"
    if _is_binary_stl(data) or (head.lstrip().startswith(b"solid") and b"facet" in head):
        return "stl"
    if b"\0" not in head and _OBJ.search(data, 0, _COMMENTS):
        return "obj"
    return None


def _is_binary_stl(data: bytes) -> bool:
    # 80 bytes of header, the number of triangles, 50 bytes for each of them
    return len(data) > 84 and len(data) == 84 + 50 * struct.unpack_from("<I", data, 80)[0]
