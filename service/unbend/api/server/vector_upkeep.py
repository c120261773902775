"""The upkeep of the vectors by which PostgreSQL searches: made at the start of a server, and indexed as they grow."""

from __future__ import annotations

import asyncio
import logging
from typing import Final

from unbend.errors import StoreError, VectorsMissingError
from unbend.library import Library
from unbend.library.search import SearchChoice

logger = logging.getLogger("unbend.search")

_AGAIN_SECONDS: Final = 600.0
"""Time between two looks for vectors that are missing, and for indexes that should be built."""


class VectorUpkeep:
    """Makes the vectors of a library in PostgreSQL, and builds their indexes; used within one event loop.

    Any number of servers may do so at a time: one of them works.
    """

    def __init__(self, library: Library, choice: SearchChoice) -> None:
        self._library = library
        self._choice = choice
        self._task: asyncio.Task[None] | None = None

    def start(self) -> None:
        """Start the upkeep, which takes minutes for a large library. Searches meanwhile use the index in memory."""
        self._task = asyncio.create_task(self._run(), name="unbend vectors")

    async def stop(self) -> None:
        """Stop; a build that has begun ends in its thread."""
        if self._task:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)

    async def _run(self) -> None:
        while True:
            try:
                await asyncio.to_thread(self._library.search.prepare_vectors)
            except VectorsMissingError as error:
                if self._choice == "auto":
                    logger.info("every server keeps the search index in memory: %s", error)
                    return
                logger.error("%s. %s", error, error.advice)  # noqa: TRY400  no traceback
            except StoreError as error:
                logger.warning("the vectors of the search cannot be prepared now: %s", error)
            await asyncio.sleep(_AGAIN_SECONDS)
