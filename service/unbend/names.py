"""Default and longest names, and the conversion of file names, which may be any bytes, to text."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

DEFAULT_LIBRARY: Final = "unbend.db"
"""File of the library if none is named."""

MAX_TEXT: Final = 200
"""Longest name of a shape, a class or a key, in characters."""

_SHAPE_ID: Final = re.compile(r"[0-9a-f]{32}")


def is_shape_id(text: str) -> bool:
    """Return whether a text has the form of a shape's id: 32 hexadecimal digits."""
    return _SHAPE_ID.fullmatch(text) is not None


def printable(name: str) -> str:
    r"""Return `name` with an escape such as \xe9 for each byte that is not UTF-8."""
    try:
        return name.encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")
    except UnicodeEncodeError:  # Windows allows unpaired surrogates
        return name.encode("utf-8", "backslashreplace").decode()


def shape_name(file_name: str) -> str:
    """Return the name of the shape of a file without a given name: the stem of the file's name, or "unnamed"."""
    return printable(Path(file_name or "unnamed").stem)[:MAX_TEXT]
