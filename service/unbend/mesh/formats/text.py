"""Text files: line ends, byte order marks, comments and fast parsing of numbers."""

from __future__ import annotations

import contextlib
import re
import warnings
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from unbend.arrays import Floats, Indices
from unbend.mesh.formats.spans import firsts_of

MARK: Final = b"\xef\xbb\xbf"
"""The byte order mark that some editors put before UTF-8."""

_NUMBER: Final = re.compile(rb"[-+]?(?:(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?|nan|inf(?:inity)?)", re.IGNORECASE)
_WORD: Final = re.compile(rb"\S+")
_COMMENT: Final = re.compile(rb"#[^\n]*")
_MARKED: Final = re.compile(rb"([-+]?)1\.#(?:(inf)|ind|qnan|snan)\d*", re.IGNORECASE)
_PADDING: Final = b"\0\x1a \t\r\n"  # \x1a ended text files on old systems
_SPACE, _NEWLINE = 32, 10


def plain(data: bytes) -> bytes:
    """Return text without a byte order mark and without padding at its end. Every line ends in a newline.

    Old Windows runtimes write numbers that are not finite as 1.#QNAN or 1.#INF. These become nan and inf.
    """
    text = data.removeprefix(MARK).rstrip(_PADDING) + b"\n"
    if b"1.#" in text:
        text = _MARKED.sub(lambda found: found[1] + (b"inf" if found[2] else b"nan"), text)
    return text.replace(b"\r\n", b"\n").replace(b"\r", b"\n") if b"\r" in text else text


def without_comments(text: bytes) -> bytes:
    """Return text without comments, which reach from # to the end of a line. Line numbers do not change."""
    return _COMMENT.sub(b"", text) if b"#" in text else text


def shown(text: bytes | str) -> str:
    """Return the beginning of `text` in quotes, for an error message."""
    return repr((text if isinstance(text, str) else text.decode("utf-8", "replace")).strip()[:40])


@dataclass(frozen=True)
class Table:
    """The numbers of some lines of text, up to the first line that contains anything else."""

    values: Floats
    """All numbers, one after the other."""
    widths: Indices
    """The count of numbers in each line, (lines,)."""
    broken: int | None
    """The index of the line that contains anything else, None if there is none."""

    @property
    def starts(self) -> Indices:
        """The start of each line in `values`, (lines,)."""
        return firsts_of(self.widths)


def table(text: bytes, fractions: int | None = None) -> Table:
    """Return the numbers of `text`, line by line.

    If only the first `fractions` lines have fractions, the whole numbers after them are read several times as fast.
    """
    lines = _lines(text)
    widths = _widths(text, lines)
    if not widths.any():
        return Table(np.empty(0), widths, None)
    whole_from = len(text) if fractions is None or fractions >= len(lines) else int(lines[fractions])
    for begin in dict.fromkeys((whole_from, len(text))):
        with contextlib.suppress(DeprecationWarning, ValueError):
            values = np.append(_numbers(text[:begin], np.float64), _numbers(text[begin:], np.int64))
            if len(values) == widths.sum():
                return Table(values, widths, None)
    # NumPy stopped early, or took a word such as "1-2" for two numbers: find the first word that is not a number.
    begin = next((word.start() for word in _WORD.finditer(text) if not _NUMBER.fullmatch(word[0])), len(text))
    before = text[: text.rfind(b"\n", 0, begin) + 1]
    widths = _widths(before, _lines(before))
    return Table(_numbers(before, np.float64), widths, len(widths))


def _numbers(text: bytes, kind: type) -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)  # NumPy warns about a word that is not a number
        return np.fromstring(text, kind, sep=" ")


def _lines(text: bytes) -> Indices:
    """Return the start of each line. Text after the last newline is also a line."""
    begins = np.append(0, np.flatnonzero(np.frombuffer(text, np.uint8) == _NEWLINE) + 1)
    return begins[begins < len(text)]


def _widths(text: bytes, lines: Indices) -> Indices:
    """Return the number of words in each line."""
    if not len(lines):
        return np.empty(0, np.int64)
    begins = np.frombuffer(text, np.uint8) > _SPACE
    begins[1:] &= ~begins[:-1].copy()
    return np.add.reduceat(begins, lines, dtype=np.int64)


def leading_numbers(text: bytes) -> tuple[bytes, int]:
    """Return text with each line cut before its first word that is not a number, and the number of lines cut.

    A line that begins with such a word stays as it is. So does a line in which that word is `v` or `f`, because it is
    probably two lines without a line break.
    """
    lines, cut = text.split(b"\n"), 0
    for number, line in enumerate(lines):
        words = line.split()
        good = next((i for i, word in enumerate(words) if not _NUMBER.fullmatch(word)), len(words))
        if 0 < good < len(words) and words[good].lower() not in (b"v", b"f"):
            lines[number] = b" ".join(words[:good])
            cut += 1
    return b"\n".join(lines), cut


def lines_of(key: str, rows: NDArray[Any], item: str = "%r") -> str:
    """Return rows (n, k) of numbers as lines that begin with `key`, with all digits."""
    per_row = rows.shape[1] // item.count("%")
    line = " ".join([key, *[item] * per_row] if key else [item] * per_row) + "\n"
    return line * len(rows) % tuple(rows.ravel().tolist())
