"""Connections to a running service."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from unbend.client import Client

KEY_VARIABLE: Final = "UNBEND_API_KEY"
"""The environment variable of the API key. A command line option would be visible in the list of processes."""


def connect(url: str) -> Client:
    """Return a client of the service at `url`, with the API key of the environment."""
    from unbend.client import Client  # noqa: PLC0415

    return Client(url, os.environ.get(KEY_VARIABLE) or None)
