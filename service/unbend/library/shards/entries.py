r"""The format of a shard: entries, one after the other. Each is a line of JSON, and then the bytes of its parts.

    shard = entry of kind "shard", any entries, entry of kind "end"
    entry = checksum, space, JSON, "\n", and, if it has parts, their bytes and "\n"

The checksum is the first 16 hexadecimal digits of the SHA-256 of the JSON. `parts` in the JSON has the size and the
SHA-256 of each part, in their order. An unfinished shard has no entry of kind "end". Nothing in a shard is executed
when it is read.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Final

from unbend.errors import ResultsError

FORMAT: Final = 1
"""Version of the format."""

SUFFIX: Final = ".shard"
UNFINISHED: Final = ".shard.part"

BEGIN: Final = "shard"
END: Final = "end"

_CHECKSUM_DIGITS: Final = 16
_LONGEST_LINE: Final = 2**20
_PIECE: Final = 2**20
_HASH: Final = re.compile(r"[0-9a-f]{64}")


@dataclass(frozen=True)
class Part:
    """The bytes of an entry that have a name."""

    offset: int
    size: int
    sha256: str


@dataclass(frozen=True)
class Entry:
    """An entry of a shard, without the bytes of its parts."""

    path: Path
    """The file of the shard."""
    offset: int
    end: int
    content: Mapping[str, Any]
    """The JSON. Its checksum is right, but anybody may have written it."""
    parts: Mapping[str, Part]

    @property
    def kind(self) -> object:
        """The kind, which is a text if the entry is valid."""
        return self.content.get("kind")

    def error(self, problem: str) -> ResultsError:
        """Return an error that names the file and the place of this entry."""
        return fault(self.path, self.offset, problem)


def fault(path: Path, offset: int, problem: str) -> ResultsError:
    """Return the error of a damaged shard."""
    return ResultsError(f"{path}, byte {offset}: {problem}").with_advice(
        f"Remove {path}, and run the `unbend compute` that wrote it again: it computes what is missing."
    )


def encode(kind: str, content: Mapping[str, Any], parts: Mapping[str, bytes]) -> list[bytes]:
    """Return the pieces of an entry."""
    sizes = {name: [len(data), hashlib.sha256(data).hexdigest()] for name, data in parts.items()}
    text = json.dumps({"kind": kind, **content, "parts": sizes}, separators=(",", ":")).encode()
    line = b"%s %s\n" % (_checksum(text), text)
    return [line, *parts.values(), b"\n"] if parts else [line]


def read_entries(path: Path) -> Iterator[Entry]:
    """Yield the entries of a finished shard between the first and the last. The parts are not read.

    Raises
    ------
    ResultsError
        If the shard is damaged or incomplete, or has another format. The message names the file and the place.
    """
    with _opened(path) as file:
        entries = _entries(file, path)
        if (first := next(entries, None)) is None:
            raise fault(path, 0, "the file is empty")
        _check_begin(first)
        last, count = first, 0
        for entry in entries:
            if last.kind == END:
                raise entry.error("there is something after the end")
            if entry.kind != END:
                count += 1
                yield entry
            last = entry
        if last.kind != END:
            raise fault(path, last.end, "the file ends early")
        if last.content.get("entries") != count:
            raise last.error(f"there are {count} entries, and the end counts {last.content.get('entries')!r}")


def read_unfinished(path: Path) -> Iterator[Entry]:
    """Yield the entries of an unfinished shard, from the first, up to one that is incomplete or damaged.

    Other than `read_entries`, this reads all parts.
    """
    try:
        with _opened(path) as file:
            for place, entry in enumerate(_entries(file, path)):
                if entry.kind == END:  # written, but the file has not got its final name
                    return
                if place == 0:
                    _check_begin(entry)
                for name in entry.parts:
                    check_part(entry, name)
                yield entry
    except ResultsError:
        return


def read_entry(path: Path, offset: int) -> Entry:
    """Return the entry at a place; ResultsError if there is none."""
    with _opened(path) as file:
        return _entry(file, path, offset, os.fstat(file.fileno()).st_size)


def read_part(entry: Entry, name: str) -> bytes:
    """Return the bytes of a part; ResultsError if they are damaged."""
    part = entry.parts[name]
    with _opened(entry.path) as file:
        file.seek(part.offset)
        data = file.read(part.size)
    if hashlib.sha256(data).hexdigest() != part.sha256:
        raise _broken(entry, name)
    return data


def check_part(entry: Entry, name: str) -> None:
    """Check the bytes of a part, without holding them in memory; ResultsError if they are damaged."""
    part = entry.parts[name]
    found, left = hashlib.sha256(), part.size
    with _opened(entry.path) as file:
        file.seek(part.offset)
        while left and (piece := file.read(min(_PIECE, left))):
            found.update(piece)
            left -= len(piece)
    if found.hexdigest() != part.sha256:
        raise _broken(entry, name)


def _broken(entry: Entry, name: str) -> ResultsError:
    return fault(entry.path, entry.parts[name].offset, f"the part {name!r} is damaged")


@contextmanager
def _opened(path: Path) -> Iterator[BinaryIO]:
    try:
        with path.open("rb") as file:
            yield file
    except OSError as error:
        raise ResultsError(f"{path} cannot be read: {error.strerror}").with_advice(
            "Check the path, and whether you may read the file."
        ) from None


def _entries(file: BinaryIO, path: Path) -> Iterator[Entry]:
    offset, size = 0, os.fstat(file.fileno()).st_size
    while offset < size:
        entry = _entry(file, path, offset, size)
        yield entry
        offset = entry.end


def _entry(file: BinaryIO, path: Path, offset: int, size: int) -> Entry:
    file.seek(offset)
    line = file.readline(_LONGEST_LINE)
    checksum, text = line[:_CHECKSUM_DIGITS], line[_CHECKSUM_DIGITS + 1 : -1]
    if line != b"%s %s\n" % (checksum, text) or checksum != _checksum(text):
        raise fault(path, offset, "the entry is damaged or incomplete")
    try:
        content = json.loads(text)
        parts, end = _parts(content["parts"], offset + len(line))
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        raise fault(path, offset, "the entry is malformed") from None
    if end > size:
        raise fault(path, offset, "the entry is incomplete")
    if parts:
        file.seek(end)
        if file.read(1) != b"\n":
            raise fault(path, offset, "the entry is damaged or incomplete")
        end += 1
    return Entry(path, offset, end, content, parts)


def _parts(described: Mapping[str, Any], offset: int) -> tuple[dict[str, Part], int]:
    """Return the parts of an entry, and the place after them; ValueError if they are malformed."""
    parts = {}
    for name, (size, sha256) in described.items():
        if type(size) is not int or size < 0 or not _HASH.fullmatch(sha256):
            raise ValueError(name)
        parts[name] = Part(offset, size, sha256)
        offset += size
    return parts, offset


def _check_begin(entry: Entry) -> None:
    if entry.kind != BEGIN:
        raise entry.error("the file is no shard")
    found = entry.content.get("format")
    if found != FORMAT:
        raise entry.error(f"the shard has the format {found!r}, and this version of unbend reads {FORMAT}")


def _checksum(text: bytes) -> bytes:
    return hashlib.sha256(text).hexdigest()[:_CHECKSUM_DIGITS].encode()
