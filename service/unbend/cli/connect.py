"""Connections to a running service."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from unbend.client import Client


def connect(url: str) -> Client:
    """Return a client of the service at `url`, with the API key of UNBEND_API_KEY.

    There is no option for the key, because it would be visible in the list of processes.
    """
    from unbend.client import Client  # noqa: PLC0415

    return Client(url)
