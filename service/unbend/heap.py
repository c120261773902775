"""Memory of the process: what large bodies took is given back to the system when they are gone."""

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
    """Have what is larger than a megabyte allocated apart, so that it goes back when it is freed.

    glibc raises that bound as large blocks are freed, and keeps a heap for each thread: a server that once answered
    many large bodies would keep their memory. Other systems are left as they are.
    """
    if libc := _glibc():
        libc.mallopt(_MMAP_THRESHOLD, _LARGE)
        libc.mallopt(_ARENA_MAX, _ARENAS)


def give_back() -> None:
    """Give free memory back to the system; takes milliseconds, in which the interpreter goes on."""
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
