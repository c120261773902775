"""Which format some bytes are: by their content first, for a name proves nothing."""

from __future__ import annotations

import re
import struct
from typing import Final

from unbend.errors import MeshFormatError

FORMATS: Final = ("off", "obj", "ply", "stl", "glb")
"""The allow-list: single files, no archives, nothing that refers to other files."""

_OFF = re.compile(rb"^(\s|#[^\n]*\n)*(ST)?C?N?OFF\b", re.IGNORECASE)
_OBJ = re.compile(rb"^[^\S\n]*(v|f)[^\S\n]+[-+.\d]", re.MULTILINE)  # within a line: in linear time
_HEAD = 4096
_FIRST_LINES = 2**20  # of an obj file may be comments; one with more is told by its name
_PACKED: Final = {
    b"PK\x03\x04": "zip", b"PK\x05\x06": "zip", b"\x1f\x8b": "gzip", b"BZh": "bzip2", b"\xfd7zXZ\0": "xz",
    b"7z\xbc\xaf\x27\x1c": "7z", b"Rar!": "rar", b"\x28\xb5\x2f\xfd": "zstd", b"DRACO": "Draco",
}  # fmt: skip
"""How packed files begin; whatever they are called, nothing is unpacked."""


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
        If the content is of no known format and the hint is none either, or the file is packed.
    """
    found = _by_content(data)
    if found:
        return found
    if packing := _packing(data):
        raise MeshFormatError(f"the file is packed ({packing}), and nothing is unpacked: send the mesh itself")
    if hint in FORMATS:
        return hint
    what = "empty" if not data[:_FIRST_LINES].strip() else f"a .{hint} file" if hint else "of no format we know"
    raise MeshFormatError(f"the file is {what}; formats read are {', '.join(FORMATS)}")


def _by_content(data: bytes) -> str | None:
    head = data[:_HEAD]
    if head.startswith(b"glTF"):
        return "glb"
    if re.match(rb"ply\s", head):
        return "ply"
    if _OFF.match(head):
        return "off"
    if is_binary_stl(data) or (head.lstrip().startswith(b"solid") and b"facet" in head):
        return "stl"
    if b"\0" not in head and _OBJ.search(data, 0, _FIRST_LINES):
        return "obj"
    return None


def _packing(data: bytes) -> str | None:
    if data[257:262] == b"ustar":
        return "tar"
    return next((name for beginning, name in _PACKED.items() if data.startswith(beginning)), None)


def is_binary_stl(data: bytes) -> bool:
    """Say whether a file is as long as the number of triangles in it says: 50 bytes each, behind 84 of header."""
    return len(data) > 84 and len(data) == 84 + 50 * struct.unpack_from("<I", data, 80)[0]
