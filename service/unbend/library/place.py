"""Where an SQLite library lies: whether its file is still the one that was opened, and how much room its disk has.

SQLite keeps writing to a file that was removed, and all of it is gone when the last connection closes. The reserve is a
file beside the library. It is given up when the disk is full, so that shapes can be removed and jobs can end.
"""

from __future__ import annotations

import contextlib
import logging
import os
import shutil
import threading
from pathlib import Path
from typing import Final

from unbend.errors import StoreFullError, StoreLostError

logger = logging.getLogger("unbend.library")

_Identity = tuple[int, int] | None

_SMALL: Final = 2**20
"""Bytes that a change needs beside the data it stores: rows, indexes, the log. A job's result needs no more."""

_UPLOAD: Final = 2 * _SMALL
"""Bytes that an upload needs beside its file. More than a result, so that jobs can begin where uploads are taken."""


class Place:
    """The file of an open library, and its disk. Thread-safe.

    Parameters
    ----------
    path : Path
        Of an SQLite database that is open, in WAL mode.
    """

    def __init__(self, path: Path) -> None:
        real = path.resolve()  # SQLite keeps the log beside the file that a link leads to
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
        """Keep `size` bytes of the disk for the changes that make room, from now on and whenever they are free."""
        with self._lock:
            self._bytes = size
            self._take()

    def release(self) -> bool:
        """Give the reserve back to the disk; False if it was given back before."""
        with self._lock:
            held = self._held()
            if held:
                self._reserve.unlink(missing_ok=True)
                logger.error("the disk of the library is full: the reserve of %d bytes is given up", held)
            return held > 0

    def free(self) -> int:
        """Return the free bytes of the disk, with those in reserve."""
        return shutil.disk_usage(self._folder).free + self._held()

    def admit(self, size: int | None, unused: int) -> None:
        """Raise StoreFullError if an upload cannot be stored without the reserve.

        Parameters
        ----------
        size : int or None
            Bytes of its file; None for the result of a job, which needs less.
        unused : int
            Bytes of the library's file that hold nothing, such as those of removed shapes.
        """
        if not self._bytes:
            return
        with self._lock:
            if not self._held():
                self._take()
            needed = _SMALL if size is None else size + _UPLOAD
            left = self.free() - self._bytes - max(0, needed - unused)
        if left < 0:
            more = f"{size} more bytes" if size else "more"  # a length that comes in chunks is not known
            raise StoreFullError(f"the library's disk has no room for {more}")

    def close(self) -> None:
        """Give the reserve back."""
        with self._lock:
            if self._bytes:
                self._reserve.unlink(missing_ok=True)

    def _held(self) -> int:
        try:
            return self._reserve.stat().st_blocks * 512
        except OSError:
            return 0

    def _take(self) -> None:
        if self._held() >= self._bytes or shutil.disk_usage(self._folder).free < self._bytes + _SMALL:
            return
        try:
            with self._reserve.open("wb") as file:
                os.posix_fallocate(file.fileno(), 0, self._bytes)
        except OSError as error:
            logger.warning("the reserve of the library's disk cannot be made: %s", error.strerror)
            with contextlib.suppress(OSError):
                self._reserve.unlink(missing_ok=True)


def _identity(path: Path) -> _Identity:
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_dev, found.st_ino
