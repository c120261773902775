"""Hosts as they are written: whether one is an address, and whether only this machine can reach it."""

from __future__ import annotations

from functools import lru_cache
from ipaddress import ip_address
from typing import Final

_MOST: Final = 1024
"""Hosts that are remembered: every request asks of its own, and most are the same."""


@lru_cache(_MOST)
def is_loopback(host: object) -> bool:
    """Return whether a host is one that only this machine can reach."""
    try:
        return ip_address(str(host)).is_loopback
    except ValueError:
        return host == "localhost"


@lru_cache(_MOST)
def is_address(host: str) -> bool:
    """Return whether a host is an address, and not a name."""
    try:
        ip_address(host)
    except ValueError:
        return False
    return True
