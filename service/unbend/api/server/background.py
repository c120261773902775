"""Work that a server does besides requests and jobs, from its start to its stop."""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod
from typing import ClassVar


class Background(ABC):
    """A task of a server; used within one event loop. Work that it has begun in a thread ends there."""

    name: ClassVar[str]
    """The name of the task, for people who debug."""

    def __init__(self) -> None:
        self._task: asyncio.Task[None] | None = None

    def start(self) -> None:
        """Start the work."""
        self._task = asyncio.create_task(self._run(), name=f"unbend {self.name}")

    async def stop(self) -> None:
        """Stop the work."""
        if self._task:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)

    @abstractmethod
    async def _run(self) -> None:
        """Work until the task is cancelled."""
