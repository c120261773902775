"""The lease of a library: only the server that has it runs the library's jobs.

The lease is an operating system lock on a file beside the library. It ends when its process ends, even by a crash. The
library's own file is not locked, because on some file systems such locks conflict with SQLite's.
"""

from __future__ import annotations

import os
from pathlib import Path
from types import TracebackType
from typing import Self

from unbend.errors import ParameterError, StoreError, StoreInUseError
from unbend.library.storage.database import sqlite_file

try:
    import fcntl
except ImportError:  # Windows: a second server is not detected
    fcntl = None  # type: ignore[assignment]


class Lease:
    """The right to run a library's jobs, until it is closed or the process ends.

    Parameters
    ----------
    url : str
        The library: a path of an SQLite file, or an SQLAlchemy URL. Libraries in memory and in other databases
        have no lease, and neither have libraries on Windows: any number of servers may open them.

    Raises
    ------
    StoreInUseError
        If another server has the lease.
    StoreError
        If the file beside the library cannot be opened.
    """

    def __init__(self, url: str) -> None:
        self._handle: int | None = None
        try:
            library = sqlite_file(url)
        except ParameterError:
            return
        if fcntl is None:
            return
        place = Path(f"{library.resolve()}-lease")  # a link leads to the same library
        try:
            self._handle = os.open(place, os.O_RDWR | os.O_CREAT, 0o644)
        except OSError as error:
            raise StoreError(f"the lease {place} cannot be opened: {error.strerror}") from error
        try:
            fcntl.flock(self._handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            owner = os.pread(self._handle, 20, 0).decode(errors="replace").strip()
            self.close()
            process = f"process {owner}" if owner.isdecimal() else "its process is unknown"
            raise StoreInUseError(f"another server runs the jobs of {library} already: {process}") from None
        os.ftruncate(self._handle, 0)
        os.pwrite(self._handle, str(os.getpid()).encode(), 0)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Release the lease."""
        if self._handle is not None:
            os.close(self._handle)
            self._handle = None
