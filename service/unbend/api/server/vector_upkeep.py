"""The upkeep of the vectors by which PostgreSQL searches: made at the start of a server, and indexed as they grow."""

from __future__ import annotations

import asyncio
import logging
from typing import Final

from unbend.api.server.background import Background
from unbend.errors import StoreError, VectorsMissingError
from unbend.library import Library
from unbend.library.search import SearchChoice

logger = logging.getLogger("unbend.search")

_AGAIN_SECONDS: Final = 600.0
"""Time between two looks for vectors that are missing, and for indexes that should be built."""


class VectorUpkeep(Background):
    """Makes the vectors of a library in PostgreSQL, and builds their indexes.

    Any number of servers may do so at a time: one of them works. That takes minutes for a large library. Searches
    meanwhile use the index in memory.
    """

    name = "vectors"

    def __init__(self, library: Library, choice: SearchChoice) -> None:
        super().__init__()
        self._library = library
        self._choice = choice

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
