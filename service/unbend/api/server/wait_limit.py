"""A limit on long polls and event streams, because each occupies a connection and a subscription."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager
from typing import Final

from unbend.errors import BusyError

RETRY_SECONDS: Final = 5


class WaitLimit:
    """Counts long polls and streams; used within one event loop."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._open = 0

    def check(self) -> None:
        """Raise BusyError at the limit."""
        if self._open >= self._most:
            raise BusyError(f"{self._open} requests wait for jobs already", RETRY_SECONDS)

    @contextmanager
    def one(self) -> Iterator[None]:
        """Count a long poll while it waits."""
        self.check()
        with self._counted():
            yield

    async def stream(self, parts: AsyncIterator[str]) -> AsyncIterator[str]:
        """Count a stream while it is open; call `check` before.

        Counting starts with the first item, because a stream that is never started also never ends.
        """
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
