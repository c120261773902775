"""Writes the files of one shard, so that a process may be killed at any moment and the next one continues."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

from unbend.errors import ResultsError
from unbend.library.shards.entries import BEGIN, END, FORMAT, SUFFIX, UNFINISHED, Entry, encode, read_unfinished
from unbend.library.shards.numbering import ShardNumber
from unbend.library.storage.disk import sync

try:
    import fcntl
except ImportError:  # Windows: a second process of the same shard is not detected
    fcntl = None  # type: ignore[assignment]

FULL_BYTES: Final = 2**28
"""A file of this size is finished, and another begun: 256 MB are soon copied, and 100,000 meshes need few files."""

_NAME: Final = re.compile(r"\d+-of-(\d+)\.(\d+)")


@dataclass(frozen=True)
class _Reached:
    """The complete entries of an unfinished file."""

    size: int
    count: int


class ShardWriter:
    """Appends entries to the unfinished file of a shard, and finishes it once it is full and at the end.

    The unfinished file has the name of the finished one and `.part`. What is flushed is on disk. A process that
    continues keeps the entries that are complete, and removes the rest.

    Parameters
    ----------
    folder : Path
        The folder of all shards. It is created if it is missing.
    shard : ShardNumber
    about : mapping
        JSON values for the first entry of each file.
    full_bytes : int

    Raises
    ------
    ResultsError
        If another process writes this shard.
    OSError
        If a file cannot be written.
    """

    def __init__(
        self, folder: Path, shard: ShardNumber, about: Mapping[str, Any], full_bytes: int = FULL_BYTES
    ) -> None:
        self._folder, self._shard, self._about, self._full_bytes = folder, shard, about, full_bytes
        folder.mkdir(parents=True, exist_ok=True)
        self._unfinished = folder / f"{shard.stem}{UNFINISHED}"
        self._handle: int | None = self._locked()
        # One value, so that a signal handler that raises never leaves a size without its count.
        self._reached = _Reached(0, 0)
        for count, entry in enumerate(read_unfinished(self._unfinished)):  # the first entry does not count
            self._reached = _Reached(entry.end, count)
        self._try(os.ftruncate, self._handle, self._reached.size)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if error is None:
            self.close()
            return
        with suppress(OSError):  # such as a full disk, of which the user is told already
            self.close()

    def earlier(self) -> Iterator[Entry]:
        """Yield the entries that an interrupted process left in the unfinished file."""
        yield from (entry for entry in read_unfinished(self._unfinished) if entry.kind != BEGIN)

    def finished(self) -> list[Path]:
        """Return the finished files that may have results for files of this shard, the earliest first.

        These are its own, and those of a division into another number of shards. Other shards of the same division
        have other files.
        """
        return [
            path
            for path in sorted(self._folder.glob(f"*{SUFFIX}"))
            if path.name.startswith(f"{self._shard.stem}.") or _count_of(path) != self._shard.count
        ]

    def append(self, entry: Sequence[bytes]) -> None:
        """Write an entry, which is on disk after the next `flush`."""
        if not self._reached.size:
            begin = encode(BEGIN, {"format": FORMAT, "shard": str(self._shard), **self._about}, {})
            self._reached = _Reached(self._write(begin), 0)
        self._reached = _Reached(self._write(entry), self._reached.count + 1)

    def flush(self) -> None:
        """Wait until all entries are on disk; then finish the file if it is full."""
        os.fsync(self._opened())
        if self._reached.size >= self._full_bytes:
            self._finish()
            self._handle = self._locked()

    def close(self) -> None:
        """Finish the file; remove it if it has no entry."""
        if self._handle is None:
            return
        try:
            if self._reached.count:
                self._finish()
            else:
                self._unfinished.unlink(missing_ok=True)
        finally:
            if self._handle is not None:
                os.close(self._handle)
                self._handle = None

    def _write(self, pieces: Sequence[bytes]) -> int:
        """Write the pieces after the complete entries, and return the place after them.

        An interrupted write leaves nothing that counts.
        """
        offset = self._reached.size
        for piece in pieces:
            view = memoryview(piece)
            while view:
                written = self._try(os.pwrite, self._opened(), view, offset)
                offset, view = offset + written, view[written:]
        return offset

    def _finish(self) -> None:
        """Give the file its end and its final name."""
        end, handle = self._write(encode(END, {"entries": self._reached.count}, {})), self._opened()
        self._try(os.ftruncate, handle, end)
        self._try(os.fsync, handle)
        number = 1 + max((_place_of(path) for path in self._folder.glob(f"{self._shard.stem}.*{SUFFIX}")), default=-1)
        self._unfinished.rename(self._folder / f"{self._shard.stem}.{number:04}{SUFFIX}")
        self._sync_folder()
        self._reached, self._handle = _Reached(0, 0), None
        os.close(handle)

    def _sync_folder(self) -> None:
        """Wait until the new name is on disk. Some file systems cannot wait for a folder, and need not."""
        with suppress(OSError):
            sync(self._folder)

    def _opened(self) -> int:
        if self._handle is None:
            raise ResultsError(f"{self._unfinished} is closed")
        return self._handle

    def _locked(self) -> int:
        """Open the unfinished file, and lock it where the file system has locks."""
        while True:
            handle = os.open(self._unfinished, os.O_RDWR | os.O_CREAT, 0o644)
            try:
                if fcntl is not None:
                    fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                os.close(handle)
                raise ResultsError(
                    f"another process computes shard {self._shard}, and writes {self._unfinished}"
                ).with_advice("Wait for its end, or choose another --shard.") from None
            except OSError:
                return handle  # a file system without locks
            if _is_at(handle, self._unfinished):
                return handle
            os.close(handle)  # another process has finished this file meanwhile

    def _try(self, call: Any, *arguments: Any) -> Any:
        try:
            return call(*arguments)
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(self._unfinished)) from None


def _is_at(handle: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(handle), path.stat())
    except FileNotFoundError:
        return False


def _count_of(path: Path) -> int:
    match = _NAME.match(path.name)
    return int(match[1]) if match else 0


def _place_of(path: Path) -> int:
    match = _NAME.match(path.name)
    return int(match[2]) if match else 0
