"""Detection of a file's format, from its content first, because the name may be wrong."""

from __future__ import annotations

from typing import Final

from unbend.errors import MeshFormatError
from unbend.mesh.formats import FORMATS
from unbend.mesh.formats.others import other_format
from unbend.mesh.formats.registry import REGISTRY

_FIRST: Final = 2**20  # a file is empty if these bytes are all blanks
_PLAIN: Final = ("off", "obj", "stl")  # formats without a mandatory first word; ply and glb have one


def detect_format(data: bytes, hint: str | None = None) -> str:
    """Return the format of `data`, one of `FORMATS`.

    Parameters
    ----------
    data : bytes
        The whole file.
    hint : str, optional
        A file name's extension. It decides only if the content does not.

    Raises
    ------
    MeshFormatError
        If neither the content nor the hint determines a format that can be read. The message names the compression,
        archive or other format that the content shows.
    """
    found = next((name for name, known in REGISTRY.items() if known.recognises(data)), None)
    # Any text may contain a line that looks like obj.
    other = other_format(data) if found in (None, "obj") else None
    if found and not other:
        return found
    empty = not data[:_FIRST].strip()
    if hint in _PLAIN and not other and not empty:
        return hint
    raise MeshFormatError(f"{other or _problem(hint, empty)}; formats read are {', '.join(FORMATS)}")


def _problem(hint: str | None, empty: bool) -> str:
    if empty:
        return "the file is empty"
    if hint in FORMATS:
        return f"the name of the file says {hint}, but it does not begin like a {hint} file"
    return f"the file is a .{hint} file" if hint else "the format of the file is unknown"
