"""Settings of the C allocator, so that memory of large requests and responses returns to the operating system."""

from __future__ import annotations

import contextlib
import ctypes
import sys
from typing import Final

_MMAP_THRESHOLD: Final = -3
_ARENA_MAX: Final = -8
_LARGE: Final = 2**20
_ARENAS: Final = 2


def prepare() -> None:
    """Make glibc map blocks of more than a megabyte separately, and use only two heaps.

    A block that is mapped separately returns to the system when it is freed. By default, glibc raises the threshold as
    large blocks are freed, and creates a heap for each thread, so a server that once sent many large responses would
    keep their memory. On other systems this function does nothing.
    """
    if libc := _glibc():
        libc.mallopt(_MMAP_THRESHOLD, _LARGE)
        libc.mallopt(_ARENA_MAX, _ARENAS)


def give_back() -> None:
    """Return free memory to the system. The call takes milliseconds and releases the GIL."""
    if libc := _glibc():
        libc.malloc_trim(0)


def _glibc() -> ctypes.CDLL | None:
    if not sys.platform.startswith("linux"):
        return None
    with contextlib.suppress(OSError, AttributeError):
        libc = ctypes.CDLL(None)
        libc.mallopt  # noqa: B018  musl has none
        libc.malloc_trim  # noqa: B018
        return libc
    return None
