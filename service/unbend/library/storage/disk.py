"""The file and the disk of an SQLite library: detection of a replaced file, checks of free space, and a reserve.

SQLite keeps writing to a file that was removed, and loses all these changes when the last connection closes. The
reserve is a file beside the library. It is deleted when the disk is full, so that shapes can still be removed and jobs
can end.
"""

from __future__ import annotations

import contextlib
import logging
import os
import shutil
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Final

from unbend.errors import StoreFullError, StoreLostError

logger = logging.getLogger("unbend.library")

_Identity = tuple[int, int] | None

_RESULT_BYTES: Final = 2**20
"""Space that the result of a job takes in rows, indexes and the log."""

_UPLOAD_BYTES: Final = 2 * _RESULT_BYTES
"""Space that an upload takes in addition to its file. It exceeds `_RESULT_BYTES`, so that admitted uploads can run."""


class LibraryDisk:
    """The file of an open library, and its disk. Thread-safe.

    Parameters
    ----------
    path : Path
        An open SQLite database in WAL mode.
    unused_bytes : callable
        Returns the number of unused bytes in the file, such as those of removed shapes.
    """

    def __init__(self, path: Path, unused_bytes: Callable[[], int]) -> None:
        self._unused_bytes = unused_bytes
        real = path.resolve()  # SQLite stores the log next to the target of a link
        self._folder = real.parent
        self._files = {part: _identity(part) for part in (path, Path(f"{real}-wal"))}
        self._reserve = Path(f"{real}-reserve")
        self._bytes = 0
        self._lock = threading.Lock()

    def check(self) -> None:
        """Raise StoreLostError if the file, or its log, is not the one that was opened."""
        for part, opened in self._files.items():
            if opened is not None and _identity(part) != opened:
                raise StoreLostError(f"the library's file {part.name} was removed or replaced while it was open")

    def reserve(self, size: int) -> None:
        """Keep `size` bytes of the disk for changes that free space; the reserve is restored when space allows."""
        with self._lock:
            self._bytes = size
            self._fill_reserve()

    def release(self) -> bool:
        """Return the reserve to the disk; False if there is none."""
        with self._lock:
            reserved = self._reserved()
            if reserved:
                self._reserve.unlink(missing_ok=True)
                logger.error("the disk of the library is full: the reserve of %d bytes is released", reserved)
            return reserved > 0

    def free(self) -> int:
        """Return the free bytes of the disk, including the reserve."""
        return shutil.disk_usage(self._folder).free + self._reserved()

    def admit_upload(self, size: int) -> None:
        """Raise StoreFullError if a file of `size` bytes does not fit without the reserve."""
        self._admit(size + _UPLOAD_BYTES, f"{size} more bytes" if size else "more")  # chunked uploads have no size

    def admit_result(self) -> None:
        """Raise StoreFullError if the result of a job does not fit without the reserve."""
        self._admit(_RESULT_BYTES, "more")

    def close(self) -> None:
        """Return the reserve to the disk."""
        with self._lock:
            if self._bytes:
                self._reserve.unlink(missing_ok=True)

    def _admit(self, needed: int, content: str) -> None:
        if not self._bytes:
            return
        unused = self._unused_bytes()
        with self._lock:
            if not self._reserved():
                self._fill_reserve()
            left = self.free() - self._bytes - max(0, needed - unused)
        if left < 0:
            raise StoreFullError(f"the library's disk has no space for {content}")

    def _reserved(self) -> int:
        try:
            return self._reserve.stat().st_blocks * 512
        except OSError:
            return 0

    def _fill_reserve(self) -> None:
        if self._reserved() >= self._bytes or shutil.disk_usage(self._folder).free < self._bytes + _RESULT_BYTES:
            return
        try:
            with self._reserve.open("wb") as file:
                os.posix_fallocate(file.fileno(), 0, self._bytes)
        except OSError as error:
            logger.warning("the reserve of the library's disk cannot be created: %s", error.strerror)
            with contextlib.suppress(OSError):
                self._reserve.unlink(missing_ok=True)


def sync(path: Path) -> None:
    """Flush a file, or the entries of a folder, to disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _identity(path: Path) -> _Identity:
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_dev, found.st_ino
