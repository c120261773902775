"""Names of files, which may be any bytes, as text that can be shown and stored."""

from __future__ import annotations

from typing import Final

MAX_TEXT: Final = 200
"""Characters of the longest name, of a shape, a class or a key."""


def printable(name: str) -> str:
    r"""Return `name` with an escape, such as \xe9, for each byte of it that is no UTF-8."""
    try:
        return name.encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")
    except UnicodeEncodeError:  # half a character, as Windows allows
        return name.encode("utf-8", "backslashreplace").decode()
