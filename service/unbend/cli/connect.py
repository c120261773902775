"""Connecting to a running service."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from unbend.client import Client

KEY_VARIABLE: Final = "UNBEND_API_KEY"
"""Of the environment: an option would show the key to everyone who lists this machine's processes."""


def connect(url: str) -> Client:
    """Return a client of the service at `url`, with the key of the environment if there is one."""
    from unbend.client import Client  # noqa: PLC0415

    return Client(url, os.environ.get(KEY_VARIABLE) or None)
