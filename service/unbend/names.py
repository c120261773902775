"""Names of files as text that can be shown and stored: a name may be any bytes."""

from __future__ import annotations

from typing import Final

MAX_TEXT: Final = 200
"""Characters that the name of a shape, a class or a key may have."""


def printable(name: str) -> str:
    r"""Return `name` with an escape, such as \xe9, for each byte that is not UTF-8."""
    try:
        return name.encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")
    except UnicodeEncodeError:  # Windows allows half a surrogate pair
        return name.encode("utf-8", "backslashreplace").decode()
