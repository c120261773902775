"""How many calls may wait for a job at a time: each holds a connection and is told of every change."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager
from typing import Final

from unbend.errors import BusyError

RETRY_SECONDS: Final = 5


class Waits:
    """A count of long polls and streams; used within one event loop."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._open = 0

    def check(self) -> None:
        """Raise BusyError if as many wait as may."""
        if self._open >= self._most:
            raise BusyError(f"{self._open} calls wait for jobs already", RETRY_SECONDS)

    @contextmanager
    def one(self) -> Iterator[None]:
        """Count a call for as long as it waits."""
        self.check()
        with self._counted():
            yield

    async def stream(self, parts: AsyncIterator[str]) -> AsyncIterator[str]:
        """Count a stream from its first part on, for one that is never begun is never ended: `check` comes before."""
        with self._counted():
            async for part in parts:
                yield part

    @contextmanager
    def _counted(self) -> Iterator[None]:
        self._open += 1
        try:
            yield
        finally:
            self._open -= 1
