"""Checks of hosts: whether a host is an IP address, and whether only this machine can reach it."""

from __future__ import annotations

from functools import lru_cache
from ipaddress import ip_address
from typing import Final

_MOST: Final = 1024
"""Size of each cache. Every request checks its host, and most requests have the same hosts."""


@lru_cache(_MOST)
def is_loopback(host: object) -> bool:
    """Return whether only this machine can reach a host."""
    try:
        return ip_address(str(host)).is_loopback
    except ValueError:
        return host == "localhost"


@lru_cache(_MOST)
def is_address(host: str) -> bool:
    """Return whether a host is an IP address, not a name."""
    try:
        ip_address(host)
    except ValueError:
        return False
    return True
