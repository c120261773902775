"""Finding the format of a file from its content first, because a name proves nothing."""

from __future__ import annotations

from typing import Final

from unbend.errors import MeshFormatError
from unbend.mesh.formats import FORMATS
from unbend.mesh.formats.others import other_format
from unbend.mesh.formats.registry import REGISTRY

_FIRST: Final = 2**20  # bytes that are searched for anything but blanks
_PLAIN: Final = ("off", "obj", "stl")  # files that may begin with other words than their name; ply and glb may not


def detect_format(data: bytes, hint: str | None = None) -> str:
    """Return the format of `data`, one of `FORMATS`.

    Parameters
    ----------
    data : bytes
        The whole file.
    hint : str, optional
        A file name's extension. It decides only where the content does not.

    Raises
    ------
    MeshFormatError
        If neither the content nor the hint gives a format that is read. The message names a packing or another
        format that the content shows.
    """
    found = next((name for name, known in REGISTRY.items() if known.recognises(data)), None)
    # any text may have a line that could be of an obj file
    other = other_format(data) if found in (None, "obj") else None
    if found and not other:
        return found
    empty = not data[:_FIRST].strip()
    if hint in _PLAIN and not other and not empty:
        return hint
    raise MeshFormatError(f"{other or _said_of(hint, empty)}; formats read are {', '.join(FORMATS)}")


def _said_of(hint: str | None, empty: bool) -> str:
    if empty:
        return "the file is empty"
    if hint in FORMATS:
        return f"the file is called {hint}, and does not begin as a {hint} file does"
    return f"the file is a .{hint} file" if hint else "the file is of no format we know"
